"""Table of the messages in a chunk, from its message indexes where these are correct.

An index is used only if every record it lists is a message and the records between them are whole: the table is then
that of a sequential parse, at the cost of a few NumPy calls.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.block import TABLE
from odomcorrupt.bags.gaps import gaps_between, windows
from odomcorrupt.bags.mcap.records import MESSAGE, MESSAGE_HEADER_BYTES, RECORD_HEADER_BYTES
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from numpy.typing import NDArray

MESSAGE_HEADER = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
MOST_RECORDS = 1 << 22
"""What a chunk without an index of its messages is walked for: 64 MB of the smallest ones have half as many."""
_INDEX_ENTRY = np.dtype([("log", "<u8"), ("offset", "<u8")])


class Record(NamedTuple):
    """A record other than a message, in a chunk; its content is data[start:end]."""

    opcode: int
    start: int
    end: int


class Contents(NamedTuple):
    """Content of a chunk.

    table : (n,) of dtype TABLE, in the order of the data
    others : the other records
    """

    table: NDArray[np.void]
    others: list[Record]


def read_contents(data: NDArray[np.uint8], indexes: list[bytes], what: str) -> Contents:
    """Return the messages and other records of a chunk.

    data : (size,) the decompressed chunk
    indexes : contents of the message index records that follow it, possibly missing or wrong
    """
    indexed = _indexed(data, indexes)
    if indexed is not None:
        return indexed
    walked, others = _walk(data.data, 0, data.size, what)
    starts = np.array(walked, dtype=np.int64)
    return Contents(_table(_heads(data, starts), starts), others)


def record_bytes(data: memoryview, at: int) -> int:
    """Return the size of the record at an offset, bytes, as `record_blocks` asks for it."""
    if at + RECORD_HEADER_BYTES > len(data):
        return RECORD_HEADER_BYTES
    size = RECORD_HEADER_BYTES + int.from_bytes(data[at + 1 : at + RECORD_HEADER_BYTES], "little")
    return 0 if data[at] == 0 or (data[at] == MESSAGE and size < MESSAGE_HEADER_BYTES) else size


def _indexed(data: NDArray[np.uint8], indexes: list[bytes]) -> Contents | None:
    """Return the content by the indexes, or None where these are incomplete or wrong."""
    entries = np.frombuffer(b"".join([index[6:] for index in indexes if (len(index) - 6) % 16 == 0]), _INDEX_ENTRY)
    starts = entries["offset"].astype(np.int64)  # beyond 2^63 they are negative
    starts.sort()
    if not starts.size or starts[0] < 0 or starts[-1] > data.size - MESSAGE_HEADER_BYTES:
        return None
    heads = _heads(data, starts)
    lengths = heads["length"].astype(np.int64)  # as above
    if (heads["opcode"] != MESSAGE).any() or lengths.max() > data.size or lengths.min() < 22:
        return None
    ends = starts + lengths + RECORD_HEADER_BYTES
    gaps = gaps_between(starts, ends, data.size)
    if gaps is None:
        return None
    others: list[Record] = []
    for begin, end in gaps:
        try:
            messages, records = _walk(data.data, begin, end, "")
        except BagError:
            return None
        if messages:
            return None
        others += records
    return Contents(_table(heads, starts), others)


def _walk(data: memoryview, begin: int, end: int, what: str) -> tuple[list[int], list[Record]]:
    """Parse record by record; return the offsets of messages, and the other records."""
    starts: list[int] = []
    others: list[Record] = []
    at = begin
    while at < end:
        if data[at] == 0 or len(starts) + len(others) >= MOST_RECORDS:
            raise BagError(
                f"{what}: the record at byte {at} of the chunk has opcode 0, or is one of more than {MOST_RECORDS}; "
                "damaged bag, --recover saves the intact part"
            )
        content = at + RECORD_HEADER_BYTES
        after = content + int.from_bytes(data[at + 1 : content], "little")
        if content > end or after > end or (data[at] == MESSAGE and after < at + MESSAGE_HEADER_BYTES):
            raise BagError(
                f"{what}: the record at byte {at} of the chunk does not fit its {end} bytes; the bag is damaged, "
                "--recover saves the intact part"
            )
        if data[at] == MESSAGE:
            starts.append(at)
        else:
            others.append(Record(data[at], content, after))
        at = after
    return starts, others


def _heads(data: NDArray[np.uint8], starts: NDArray[np.int64]) -> NDArray[np.void]:
    """Gather the headers of message records, unaligned."""
    return windows(data, MESSAGE_HEADER_BYTES)[starts].view(MESSAGE_HEADER)


def _table(heads: NDArray[np.void], starts: NDArray[np.int64]) -> NDArray[np.void]:
    table = np.empty(starts.size, dtype=TABLE)
    table["channel"] = heads["channel"]
    table["log_ns"] = heads["log"].astype(np.int64)  # a time beyond 2^63 wraps, and wraps back when written
    table["offset"] = starts + MESSAGE_HEADER_BYTES
    table["length"] = heads["length"] - (MESSAGE_HEADER_BYTES - RECORD_HEADER_BYTES)
    return table

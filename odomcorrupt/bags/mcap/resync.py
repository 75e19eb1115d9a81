"""Resynchronisation in a damaged MCAP: the next plausible record, and the intact part of a truncated chunk."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.mcap.chunk import CODECS, MOST_RECORDS
from odomcorrupt.bags.mcap.records import RECORD_HEADER_BYTES, Op
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator

    from numpy.typing import NDArray

    from odomcorrupt.bags.source import Source

_WINDOW_BYTES = 1 << 20
_LOOK_BYTES = 256
_FARTHEST = 10
"""Number of following records examined to accept one."""
_ADDED_BYTES = 32
"""Fields that later versions may append to a record; no other record has room in them."""
_SHORTEST_MESSAGE = 22
_FIELDS = {
    Op.SCHEMA: (2, (4, 4, 4), 0),
    Op.CHANNEL: (4, (4, 4, 4), 0),
    Op.MESSAGE_INDEX: (2, (4,), 0),
    Op.ATTACHMENT: (16, (4, 4, 8), 4),
    Op.METADATA: (0, (4, 4), 0),
}
"""Of a record's content: the bytes before fields with a length of their own, the widths of these, the bytes behind."""
_EXACT = {Op.DATA_END: 4, Op.FOOTER: 20}
_BETWEEN_CHUNKS = (Op.CHUNK, Op.MESSAGE_INDEX, Op.ATTACHMENT, Op.METADATA, Op.DATA_END)
"""Records that never stand in a chunk, and whose length their fields repeat."""
_EVERYTHING = range(Op.FOOTER, Op.DATA_END + 1)
_SUMMARY = (
    Op.SCHEMA,
    Op.CHANNEL,
    Op.CHUNK_INDEX,
    Op.ATTACHMENT_INDEX,
    Op.STATISTICS,
    Op.METADATA_INDEX,
    Op.SUMMARY_OFFSET,
)
_PRIVATE = 0x80


def stands_here(source: Source) -> bool:
    """Return whether the next bytes are a plausible record of the data section, or its end."""
    head, here = source.sniff(_LOOK_BYTES), source.position
    if not _believable(head, 0, _left(source)):
        return False
    if head[0] < _PRIVATE:
        return True
    chained = _chained(source, here)
    source.seek(here)
    return chained


def stands_behind(source: Source, begin: int, *, failed: bool = False) -> bool:
    """Return whether the next bytes are a plausible successor of the record at byte `begin`.

    If bytes are missing from a chunk, its stated length ends inside the next one, possibly at a message, or at its
    end.

    failed : whether the record at `begin` could not be read
    """
    if not stands_here(source):
        return False
    here = source.position
    if not failed and source.sniff(1)[0] in _BETWEEN_CHUNKS:
        return True
    source.seek(begin)
    claimed = source.sniff(1)[:1] == bytes([Op.CHUNK])
    swallowed = claimed and any(_leads_to(source, at, here) for at, _ in _found(source, begin + 1, here, (Op.CHUNK,)))
    source.seek(here)
    return not swallowed


def _leads_to(source: Source, at: int, here: int) -> bool:
    """Return whether consecutive records lead from byte `at` to or past byte `here`."""
    while at < here:
        source.seek(at)
        head = source.sniff(_LOOK_BYTES)
        if not _believable(head, 0, _left(source)):
            return False
        at += RECORD_HEADER_BYTES + int.from_bytes(head[1:RECORD_HEADER_BYTES], "little")
    return True


def next_record(source: Source, begin: int, kinds: Container[int] = _EVERYTHING) -> bool:
    """Seek to the first plausible record after byte `begin`, or to the end; return whether there is one.

    Messages inside a chunk do not count, as they have no checksum of their own.
    """
    source.seek(begin)
    if source.sniff(1)[:1] == bytes([Op.CHUNK]) and stands_here(source):
        kinds = _BETWEEN_CHUNKS
    size = source.size or 0
    at, _ = next(_found(source, begin + 1, size, kinds), (size, size))
    source.seek(at)
    return at < size


def loss_of_cut_chunk(source: Source, length: int, what: str) -> str:
    """Return a sentence on a chunk of `length` bytes that is truncated by the file's end.

    Raises
    ------
    BagError
        If the chunk is damaged otherwise: its length covers later records.
    """
    here, left = source.position, _left(source)
    lost = f"{source.name}: {what} needs {length} bytes, {left} are left: the bag is truncated in a chunk"
    if any(_found(source, here, here + left, (Op.CHUNK,))):
        raise BagError(lost)
    source.seek(here)
    return lost


def whole_records(data: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the bytes (size,) of the intact records before the first damaged one."""
    view, at = data.data, 0
    for _ in range(MOST_RECORDS):
        if at + RECORD_HEADER_BYTES > data.size:
            break
        opcode, length = struct.unpack_from("<BQ", view, at)
        if length > data.size - at - RECORD_HEADER_BYTES or (opcode == Op.MESSAGE and length < _SHORTEST_MESSAGE):
            break
        if opcode == 0 or opcode in _BETWEEN_CHUNKS:
            break
        at += RECORD_HEADER_BYTES + length
    return data[:at]


def _left(source: Source) -> int:
    return (source.size or 0) - source.position


def _found(source: Source, begin: int, end: int, kinds: Container[int]) -> Iterator[tuple[int, int]]:
    """Yield start and stated end of plausible records of some kinds between bytes `begin` and `end`."""
    while begin < end:
        source.seek(begin)
        window = source.sniff(_WINDOW_BYTES + _LOOK_BYTES)
        data, left = np.frombuffer(window, dtype=np.uint8), _left(source)
        count = min(_WINDOW_BYTES, end - begin, data.size - RECORD_HEADER_BYTES + 1)
        if count <= 0:
            return
        # lengths are less than 2^40, so three of their bytes are zero
        quiet = (data[6 : 6 + count] | data[7 : 7 + count] | data[8 : 8 + count]) == 0
        for at in np.flatnonzero(quiet & (data[:count] > 1) & (data[:count] <= Op.DATA_END)).tolist():
            if window[at] in kinds and _believable(window, at, left - at) and _chained(source, begin + at):
                yield begin + at, begin + at + RECORD_HEADER_BYTES + int.from_bytes(window[at + 1 : at + 9], "little")
        begin += _WINDOW_BYTES


def _chained(source: Source, at: int) -> bool:
    """Return whether two more records follow the unknown one at byte `at`; moves the source."""
    seen, ended = 0, False
    for _ in range(_FARTHEST):
        source.seek(at)
        head, left = source.sniff(_LOOK_BYTES), _left(source)
        if left < RECORD_HEADER_BYTES:
            return True
        opcode, length = struct.unpack_from("<BQ", head)
        if not (_believable(head, 0, left) or (ended and opcode in _SUMMARY and length < left)):
            return False
        # Zeros after a number often resemble a private record, which proves nothing.
        seen += opcode < _PRIVATE
        if opcode == Op.CHUNK or seen > 2:
            return True
        ended = ended or opcode == Op.DATA_END
        at += RECORD_HEADER_BYTES + length
    return False


def _believable(window: bytes, at: int, left: int) -> bool:
    if left < RECORD_HEADER_BYTES or len(window) < at + RECORD_HEADER_BYTES:
        return False
    opcode, length = struct.unpack_from("<BQ", window, at)
    head = window[at + RECORD_HEADER_BYTES : at + _LOOK_BYTES]
    if opcode == Op.CHUNK:
        return _is_chunk(head, length)
    if opcode in _EXACT:
        return bool(0 <= length - _EXACT[opcode] < (_ADDED_BYTES if opcode == Op.DATA_END else 1))
    if length > left - RECORD_HEADER_BYTES:
        return False
    if opcode in _FIELDS:
        return _adds_up(head, length, *_FIELDS[opcode])
    return bool(opcode >= _PRIVATE or (opcode == Op.MESSAGE and length >= _SHORTEST_MESSAGE))


def _adds_up(head: bytes, length: int, before: int, widths: tuple[int, ...], behind: int) -> bool:
    """Return whether the visible lengths of a record's fields are consistent with its own.

    before, behind : bytes of the fixed fields before and after those with a length prefix
    widths : sizes of these prefixes, bytes
    """
    at = before
    for width in widths:
        if at + width > len(head) < length:
            return True
        at += width + int.from_bytes(head[at : at + width], "little")
    return 0 <= length - at - behind < _ADDED_BYTES


def _is_chunk(head: bytes, length: int) -> bool:
    name_length = int.from_bytes(head[28:32], "little")
    if len(head) < 40 + name_length or name_length > 4:
        return False
    (packed,) = struct.unpack_from("<Q", head, 32 + name_length)
    name = head[32 : 32 + name_length].decode(errors="replace")
    return 0 <= length - 40 - name_length - packed < _ADDED_BYTES and (name or "none") in CODECS

"""Message records for messages of another format and added ones."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.block import TABLE, Message
from odomcorrupt.bags.gaps import windows
from odomcorrupt.bags.mcap.chunk_messages import MESSAGE_HEADER
from odomcorrupt.bags.mcap.records import MESSAGE, MESSAGE_HEADER_BYTES, RECORD_HEADER_BYTES
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from numpy.typing import NDArray


class Framed(NamedTuple):
    """Message records.

    data : (size,) uint8
    table : (n,) of dtype TABLE, its offsets counted from the start of data
    ends : where its chunks end in data, none for one chunk
    """

    data: NDArray[np.uint8]
    table: NDArray[np.void]
    ends: tuple[int, ...] = ()

    def followed_by(self, other: Framed) -> Framed:
        """Return both, with the other one appended to the last chunk of this one."""
        if not self.data.size:
            return other
        moved = other.table.copy()
        moved["offset"] += self.data.size
        ends = self.ends[:-1] + tuple(self.data.size + end for end in other.ends or (other.data.size,))
        return Framed(np.concatenate([self.data, other.data]), np.concatenate([self.table, moved]), ends)


class Sequences:
    """Sequence numbers of messages per channel, from 0."""

    def __init__(self) -> None:
        self._next: dict[int, int] = {}

    def take(self, channels: NDArray[np.uint32]) -> NDArray[np.uint32]:
        """Return the next sequence numbers (n,) for messages of these channels (n,)."""
        numbers = np.empty(channels.size, dtype=np.uint32)
        for channel in set(channels.tolist()):
            own = np.flatnonzero(channels == channel)
            first = self._next.get(channel, 0)
            numbers[own] = np.arange(first, first + own.size)
            self._next[channel] = first + own.size
        return numbers


def frame(
    data: NDArray[np.uint8], table: NDArray[np.void], sequences: Sequences, chunks: tuple[int, ...] = ()
) -> Framed:
    """Return records of the messages in data at a table's offsets, with the table's channel ids.

    chunks : where chunks end in data; what is framed ends there, too
    """
    if table["log_ns"].min(initial=0) < 0:
        raise BagError(
            f"log time {table['log_ns'].min()} ns: is before 1970, which MCAP cannot represent; write the input's "
            "format"
        )
    lengths = table["length"]
    ends = np.cumsum(lengths + MESSAGE_HEADER_BYTES)
    framed = table.copy()
    framed["offset"] = ends - lengths
    heads = np.empty(table.size, dtype=MESSAGE_HEADER)
    heads["opcode"] = MESSAGE
    heads["length"] = lengths + (MESSAGE_HEADER_BYTES - RECORD_HEADER_BYTES)
    heads["channel"] = table["channel"]
    heads["sequence"] = sequences.take(table["channel"])
    heads["log"] = heads["publish"] = table["log_ns"]
    source = data.data
    packed = memoryview(heads.tobytes())
    pieces: list[memoryview] = []
    for row, (begin, length) in enumerate(zip(table["offset"].tolist(), lengths.tolist(), strict=True)):
        pieces.append(packed[row * MESSAGE_HEADER_BYTES : (row + 1) * MESSAGE_HEADER_BYTES])
        pieces.append(source[begin : begin + length])
    return Framed(np.frombuffer(b"".join(pieces), dtype=np.uint8), framed, _moved(chunks, table, ends))


def reframe(data: NDArray[np.uint8], table: NDArray[np.void], chunks: tuple[int, ...] = ()) -> Framed:
    """Return the message records of an MCAP's data without the other records, with the table's channel ids."""
    lengths = table["length"] + MESSAGE_HEADER_BYTES
    ends = np.cumsum(lengths)
    framed = table.copy()
    framed["offset"] = ends - table["length"]
    source = data.data
    begins = (table["offset"] - MESSAGE_HEADER_BYTES).tolist()
    joined = bytearray().join(
        source[begin : begin + length] for begin, length in zip(begins, lengths.tolist(), strict=True)
    )
    out = np.frombuffer(joined, dtype=np.uint8)
    places = ends - lengths + RECORD_HEADER_BYTES
    windows(out, 2)[places] = table["channel"].astype("<u2").view("V2")
    return Framed(out, framed, _moved(chunks, table, ends))


def _moved(chunks: tuple[int, ...], table: NDArray[np.void], ends: NDArray[np.int64]) -> tuple[int, ...]:
    """Return where chunks end among records that end at `ends` (n,)."""
    rows = np.searchsorted(table["offset"], chunks)
    return tuple(np.concatenate(([0], ends))[rows].tolist()) if chunks else ()


def frame_added(messages: list[Message], sequences: Sequences) -> Framed:
    """Return records of added messages."""
    table = np.empty(len(messages), dtype=TABLE)
    table["channel"] = [message.channel for message in messages]
    table["log_ns"] = [message.log_ns for message in messages]
    table["length"] = [len(message.data) for message in messages]
    table["offset"] = np.cumsum(table["length"]) - table["length"]
    return frame(np.frombuffer(b"".join(message.data for message in messages), dtype=np.uint8), table, sequences)

"""Message records for messages of another format and added ones."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.block import TABLE, Message
from odomcorrupt.bags.ros1.records import INDEX, MESSAGE, pack_fields, pack_record
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

_INDEX_ENTRY = np.dtype([("s", "<u4"), ("ns", "<u4"), ("offset", "<u4")])
_SECOND_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class Framed:
    """Records of messages, and of connections before them.

    data : (size,) uint8
    table : (n,) of dtype TABLE, its offsets counted from the start of data
    starts : (n,) offsets of the message records, bytes
    ends : where its chunks end in data, none for one chunk
    """

    data: NDArray[np.uint8]
    table: NDArray[np.void]
    starts: NDArray[np.int64]
    ends: tuple[int, ...] = ()

    def followed_by(self, other: Framed) -> Framed:
        """Return both, with the other one appended to the last chunk of this one."""
        moved = other.table.copy()
        moved["offset"] += self.data.size
        return Framed(
            np.concatenate([self.data, other.data]),
            np.concatenate([self.table, moved]),
            np.concatenate([self.starts, other.starts + self.data.size]),
            (*self.ends[:-1], self.data.size + other.data.size),
        )

    def chunks(self) -> Iterator[Framed]:
        """Yield its chunks, one by one."""
        begin = start = 0
        for end in self.ends[:-1]:
            stop = int(np.searchsorted(self.starts, end))
            yield self._part(begin, end, start, stop)
            begin, start = end, stop
        yield self._part(begin, self.data.size, start, len(self.starts)) if begin else self

    def _part(self, begin: int, end: int, start: int, stop: int) -> Framed:
        table = self.table[start:stop].copy()
        table["offset"] -= begin
        return Framed(self.data[begin:end], table, self.starts[start:stop] - begin)


def pack_time(log_ns: int) -> bytes:
    """Return a time in ROS 1's serialisation: seconds and nanoseconds as unsigned 32-bit words."""
    seconds, nanoseconds = divmod(log_ns, _SECOND_NS)
    if not 0 <= seconds < 1 << 32:
        raise BagError(f"log time {log_ns} ns: does not fit a ROS 1 bag (0 to 2106); write an MCAP instead")
    return struct.pack("<II", seconds, nanoseconds)


def frame(before: bytes, messages: list[Message]) -> Framed:
    """Return records of messages, after records that must precede them."""
    pieces = [before]
    rows: list[tuple[int, int, int, int]] = []
    starts: list[int] = []
    at = len(before)
    for message in messages:
        fields = {
            "conn": struct.pack("<I", message.channel),
            "op": bytes([MESSAGE]),
            "time": pack_time(message.log_ns),
        }
        pieces.append(pack_record(pack_fields(fields), message.data))
        starts.append(at)
        at += len(pieces[-1])
        rows.append((message.channel, message.log_ns, at - len(message.data), len(message.data)))
    data = np.frombuffer(b"".join(pieces), dtype=np.uint8)
    return Framed(data, np.array(rows, dtype=TABLE), np.array(starts, dtype=np.int64))


def indexes(framed: Framed) -> list[tuple[int, int, bytes]]:
    """Return (connection, count, index record) for each connection of a chunk, ascending."""
    order = np.argsort(framed.table["channel"], kind="stable")
    channels = framed.table["channel"][order]
    entries = np.empty(order.size, dtype=_INDEX_ENTRY)
    entries["s"], entries["ns"] = np.divmod(framed.table["log_ns"][order], _SECOND_NS)
    entries["offset"] = framed.starts[order]
    found: list[tuple[int, int, bytes]] = []
    bounds = [0, *(np.flatnonzero(channels[1:] != channels[:-1]) + 1).tolist(), order.size]
    for start, stop in pairwise(bounds if order.size else ()):
        connection = int(channels[start])
        header = pack_fields(
            {
                "conn": struct.pack("<I", connection),
                "count": struct.pack("<I", stop - start),
                "op": bytes([INDEX]),
                "ver": struct.pack("<I", 1),
            }
        )
        found.append((connection, stop - start, pack_record(header, entries[start:stop].tobytes())))
    return found

"""Summary section of an MCAP, collected while the data section is written."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from itertools import groupby
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.mcap.records import (
    ATTACHMENT,
    ATTACHMENT_INDEX,
    CHUNK_INDEX,
    MESSAGE_HEADER_BYTES,
    MESSAGE_INDEX,
    METADATA,
    METADATA_INDEX,
    RECORD_HEADER_BYTES,
    STATISTICS,
    SUMMARY_OFFSET,
    Fields,
    record,
    string,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

_ENTRY = np.dtype([("log", "<u8"), ("offset", "<u8")])


class ChunkSpan(NamedTuple):
    """A chunk to be written: first and last log time, compression, and bytes before it."""

    start_ns: int
    end_ns: int
    codec: str
    size: int


class ChunkPlace(NamedTuple):
    """Where a chunk record lies in the file, bytes; packed : those of its compressed records."""

    position: int
    length: int
    packed: int


class ChunkRows(NamedTuple):
    """A chunk of a block: data[begin:end], and table[start:stop]."""

    begin: int
    end: int
    start: int
    stop: int


@dataclass(slots=True, eq=False, repr=False)
class Index:
    """Statistics and indexes of a file being written."""

    counts: dict[int, int] = field(default_factory=dict)
    start_ns: int | None = None
    end_ns: int = 0
    chunks: list[bytes] = field(default_factory=list)
    attachments: list[bytes] = field(default_factory=list)
    metadata: list[bytes] = field(default_factory=list)

    def count(self, table: NDArray[np.void]) -> None:
        """Count messages."""
        for channel, count in zip(*map(np.ndarray.tolist, np.unique_counts(table["channel"])), strict=True):
            self.counts[channel] = self.counts.get(channel, 0) + count
        if table.size:
            start_ns, end_ns = span_ns(table)
            self.start_ns = start_ns if self.start_ns is None else min(self.start_ns, start_ns)
            self.end_ns = max(self.end_ns, end_ns)

    def add_chunk(self, span: ChunkSpan, place: ChunkPlace, indexes: list[tuple[int, bytes]]) -> bytes:
        """Add a chunk; return the message index records that follow it.

        indexes : channel and whole record, as `message_indexes` gives them
        """
        at = place.position + place.length
        offsets = b""
        for channel, index in indexes:
            offsets += struct.pack("<HQ", channel, at)
            at += len(index)
        self.chunks.append(
            record(
                CHUNK_INDEX,
                struct.pack("<QQQQI", span.start_ns, span.end_ns, place.position, place.length, len(offsets)),
                offsets,
                struct.pack("<Q", at - place.position - place.length),
                string("" if span.codec == "none" else span.codec),
                struct.pack("<QQ", place.packed, span.size),
            )
        )
        return b"".join(index for _, index in indexes)

    def add_record(self, opcode: int, head: bytes, position: int) -> None:
        """Add a record of the data section that the summary lists.

        head : the whole record or its first bytes, names included
        position : where it begins in the file
        """
        length = RECORD_HEADER_BYTES + int.from_bytes(head[1:RECORD_HEADER_BYTES], "little")
        fields = Fields(head[RECORD_HEADER_BYTES:], "record")
        place = struct.pack("<QQ", position, length)
        if opcode == METADATA:
            self.metadata.append(record(METADATA_INDEX, place, string(fields.string())))
        elif opcode == ATTACHMENT:
            times = struct.pack("<QQ", fields.number("Q"), fields.number("Q"))
            names = string(fields.string()) + string(fields.string())
            size = struct.pack("<Q", fields.number("Q"))
            self.attachments.append(record(ATTACHMENT_INDEX, place, times, size, names))

    def summary(
        self, schemas: list[bytes], channels: list[bytes], private: list[bytes], begin: int
    ) -> tuple[bytes, int]:
        """Return the summary section with its offsets, and where the offsets begin in the file.

        schemas, channels, private : whole records
        begin : where the section begins in the file
        """
        counts = b"".join(struct.pack("<HQ", *item) for item in sorted(self.counts.items()))
        sizes = (len(schemas), len(channels), len(self.attachments), len(self.metadata), len(self.chunks))
        statistics = record(
            STATISTICS,
            struct.pack("<QHIIII", sum(self.counts.values()), *sizes),
            struct.pack("<QQI", self.start_ns or 0, self.end_ns, len(counts)),
            counts,
        )
        groups = [schemas, channels, [statistics], self.chunks, self.attachments, self.metadata]
        groups += [list(same) for _, same in groupby(sorted(private), key=lambda one: one[0])]
        section = b""
        offsets = b""
        for group in groups:
            if group:
                data = b"".join(group)
                offsets += record(SUMMARY_OFFSET, struct.pack("<BQQ", data[0], begin + len(section), len(data)))
                section += data
        return section + offsets, begin + len(section)


def span_ns(table: NDArray[np.void]) -> tuple[int, int]:
    """Return the first and last log time of messages in nanoseconds, 0 and 0 for none."""
    times = table["log_ns"].astype(np.uint64)
    return int(times.min()) if times.size else 0, int(times.max(initial=0))


def message_indexes(table: NDArray[np.void], chunks: list[ChunkRows]) -> list[list[tuple[int, bytes]]]:
    """Return (channel, message index record) for each channel of each chunk that a table covers."""
    numbers = np.repeat(np.arange(len(chunks)), [chunk.stop - chunk.start for chunk in chunks])
    keys = numbers << 32 | table["channel"]
    order = np.argsort(keys, kind="stable")
    entries = np.empty(table.size, dtype=_ENTRY)
    entries["log"] = table["log_ns"][order]
    begins = np.array([chunk.begin for chunk in chunks], dtype=np.int64)[numbers]
    entries["offset"] = (table["offset"] - begins)[order] - MESSAGE_HEADER_BYTES
    keys = keys[order]
    bounds = [0, *(np.flatnonzero(keys[1:] != keys[:-1]) + 1).tolist(), table.size]
    packed = memoryview(entries.tobytes())
    found: list[list[tuple[int, bytes]]] = [[] for _ in chunks]
    for key, a, b in zip(keys[bounds[:-1]].tolist() if table.size else (), bounds, bounds[1:], strict=False):
        channel, content = key & 0xFFFFFFFF, packed[a * _ENTRY.itemsize : b * _ENTRY.itemsize]
        head = struct.pack("<BQHI", MESSAGE_INDEX, 6 + len(content), channel, len(content))
        found[key >> 32].append((channel, head + content))
    return found

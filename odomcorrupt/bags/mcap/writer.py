"""MCAP writer for files and pipes, without seeking: channels, framing of messages, chunks and their index."""

from __future__ import annotations

import struct
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from itertools import groupby, zip_longest
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from mcap.opcode import Opcode as Op

from odomcorrupt import __version__
from odomcorrupt.bags.block import TABLE, PartContents, require_all, with_ids
from odomcorrupt.bags.checksum import crc32
from odomcorrupt.bags.chunk import windows
from odomcorrupt.bags.codecs import compress
from odomcorrupt.bags.definition import LAST_ID, OutputChannels, retyped, with_common_text
from odomcorrupt.bags.mcap.chunk import (
    CODECS,
    INDEX_ENTRY,
    MESSAGE_HEADER,
    MESSAGE_HEADER_BYTES,
    RECORD_HEADER_BYTES,
    ChannelRecord,
    Fields,
    McapFraming,
    SchemaRecord,
    chunk_head,
    mapping,
    record,
    string,
)
from odomcorrupt.bags.mcap.reader import McapReader
from odomcorrupt.bags.output import OutputContext
from odomcorrupt.bags.source import MCAP as MAGIC
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Block, Channel, Definition
    from odomcorrupt.bags.output import Original, Output
    from odomcorrupt.bags.pipeline import Workers


_LAST_FOREIGN_ID = 0xFFFFFFFF


class ChannelTable(OutputChannels):
    """Ids and records of the channels and schemas of an output, and which of them are written.

    native : the reader, if ids and records of its own channels are kept
    """

    def __init__(self, reader: BagReader, *, native: bool = True) -> None:
        self.native = reader if native and isinstance(reader, McapReader) else None
        super().__init__(reader, LAST_ID if self.native else _LAST_FOREIGN_ID)
        self._schemas: dict[int, SchemaRecord] = {}
        self._channels: dict[int, ChannelRecord] = {}
        self._ids: dict[int, int] = {}
        self._waiting: set[int] = set()

    def header(self) -> bytes:
        """Return the content of the header record: the input's, or a new one with its profile."""
        if self.native:
            return self.native.header
        of_ros1 = all(channel.encoding == "ros1" for channel in self.reader.channels.values())
        ros1 = self.reader.kind == "ros1" or (self.reader.kind == "mcap" and of_ros1)
        return string("ros1" if ros1 else "ros2") + string(f"odomcorrupt {__version__}")

    def add(self, topic: str, msgtype: str, encoding: str, definition: Definition) -> Channel:
        """Add a channel with a given definition; return it."""
        channel = super().add(topic, msgtype, encoding, definition)
        self._register(channel, definition)
        return channel

    def written_id(self, channel: int) -> int:
        """Return the id under which a channel of the reader, or an added one, is written."""
        if channel in self._ids:
            if self.native and channel in self.native.channels:
                raise BagError(f"{self.native.name}: channel {channel} appeared after its id was given to a new topic")
            return self._ids[channel]
        known, definition = self.described(channel)
        return channel if self.native else self._register(known, definition)

    def take_records(self, written: NDArray[np.uint32]) -> bytes:
        """Return the schema and channel records that must precede messages of these written ids."""
        needed = self._waiting.intersection(written.tolist()) if self._waiting else set()
        self._waiting -= needed
        channels = [self._channels[one] for one in sorted(needed)]
        own = [(self._schemas.get(channel.schema), channel) for channel in channels]
        return b"".join((schema.pack() if schema else b"") + channel.pack() for schema, channel in own)

    def packed(self) -> tuple[list[bytes], list[bytes]]:
        """Return all schema records and all channel records, for the summary."""
        schemas, channels = dict(self._schemas), dict(self._channels)
        if self.native:
            schemas = {**self.native.schemas, **schemas}
            channels = {one.id: one.raw for one in self.native.channels.values()} | channels
        return [one.pack() for one in schemas.values()], [one.pack() for one in channels.values()]

    def topic(self, written: int) -> str:
        """Return the topic that is written under an id."""
        if self.native and written in self.native.channels:
            return self.native.channels[written].topic
        return self._channels[written].topic

    def _register(self, channel: Channel, definition: Definition) -> int:
        identifier = channel.id if self.native else len(self._ids)
        if identifier > LAST_ID:
            raise BagError(f"{channel.topic}: is topic number {identifier}; an MCAP holds {LAST_ID + 1}")
        self._ids[channel.id] = identifier
        if not definition.text and channel.encoding in ("ros1", "cdr"):
            # Old ROS 2 bags keep no definitions, but without one nothing reads an MCAP's messages.
            definition = with_common_text(definition, channel.msgtype, channel.encoding)
        schema = self._schema_id(definition)
        self._channels[identifier] = ChannelRecord(
            identifier, schema, channel.topic, channel.encoding, definition.metadata
        )
        self._waiting.add(identifier)
        return identifier

    def _schema_id(self, definition: Definition) -> int:
        if not definition.name:
            return 0
        wanted = (definition.name, definition.encoding, definition.text)
        known = {**(self.native.schemas if self.native else {}), **self._schemas}
        for schema in known.values():
            if schema[1:] == wanted:
                return schema.id
        identifier = LAST_ID if self.native else len(known) + 1
        while identifier in known:
            identifier -= 1
        self._schemas[identifier] = SchemaRecord(identifier, *wanted)
        return identifier


@dataclass(slots=True, eq=False, repr=False)
class Index:
    """Statistics and indexes of a file being written."""

    counts: Counter[int] = field(default_factory=Counter)
    start_ns: int | None = None
    end_ns: int = 0
    chunks: list[bytes] = field(default_factory=list)
    attachments: list[bytes] = field(default_factory=list)
    metadata: list[bytes] = field(default_factory=list)

    def count(self, table: NDArray[np.void]) -> None:
        """Count messages."""
        for channel, count in zip(*map(np.ndarray.tolist, np.unique_counts(table["channel"])), strict=True):
            self.counts[channel] += count
        if table.size:
            start_ns, end_ns = span_ns(table)
            self.start_ns = start_ns if self.start_ns is None else min(self.start_ns, start_ns)
            self.end_ns = max(self.end_ns, end_ns)

    def add_chunk(
        self, span: tuple[int, int], codec: str, sizes: tuple[int, int], place: tuple[int, int],
        indexes: list[tuple[int, bytes]],
    ) -> bytes:  # fmt: skip
        """Add a chunk; return the message index records that follow it.

        span : first and last log time
        sizes : bytes of its records, compressed and not
        place : where its record begins in the file, and its length
        indexes : channel and whole record, as `message_indexes` gives them
        """
        behind = at = sum(place)
        offsets = b""
        for channel, index in indexes:
            offsets += struct.pack("<HQ", channel, at)
            at += len(index)
        self.chunks.append(
            record(
                Op.CHUNK_INDEX,
                struct.pack("<QQQQI", *span, *place, len(offsets)),
                offsets,
                struct.pack("<Q", at - behind),
                string("" if codec == "none" else codec),
                struct.pack("<QQ", *sizes),
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
        if opcode == Op.METADATA:
            self.metadata.append(record(Op.METADATA_INDEX, place, string(fields.string())))
        elif opcode == Op.ATTACHMENT:
            times = struct.pack("<QQ", fields.number("Q"), fields.number("Q"))
            names = string(fields.string()) + string(fields.string())
            size = struct.pack("<Q", fields.number("Q"))
            self.attachments.append(record(Op.ATTACHMENT_INDEX, place, times, size, names))

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
            Op.STATISTICS,
            struct.pack("<QHIIII", self.counts.total(), *sizes),
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
                offsets += record(Op.SUMMARY_OFFSET, struct.pack("<BQQ", data[0], begin + len(section), len(data)))
                section += data
        return section + offsets, begin + len(section)


def span_ns(table: NDArray[np.void]) -> tuple[int, int]:
    """Return the first and last log time of messages in nanoseconds, 0 and 0 for none."""
    times = table["log_ns"].astype(np.uint64)
    return int(times.min()) if times.size else 0, int(times.max(initial=0))


def message_indexes(
    table: NDArray[np.void], chunk_begins: tuple[int, ...], stops: list[int]
) -> list[list[tuple[int, bytes]]]:
    """Return (channel, message index record) for each channel of each chunk that a table covers.

    chunk_begins, stops : offset of each chunk's data, bytes, and the row behind its last
    """
    numbers = np.repeat(np.arange(len(stops)), np.diff(stops, prepend=0))
    keys = numbers << 32 | table["channel"]
    order = np.argsort(keys, kind="stable")
    entries = np.empty(table.size, dtype=INDEX_ENTRY)
    entries["log"] = table["log_ns"][order]
    entries["offset"] = (table["offset"] - np.array(chunk_begins)[numbers])[order] - MESSAGE_HEADER_BYTES
    keys = keys[order]
    bounds = [0, *(np.flatnonzero(keys[1:] != keys[:-1]) + 1).tolist(), table.size]
    packed = memoryview(entries.tobytes())
    found: list[list[tuple[int, bytes]]] = [[] for _ in stops]
    for key, a, b in zip(keys[bounds[:-1]].tolist() if table.size else (), bounds, bounds[1:], strict=False):
        channel, content = key & 0xFFFFFFFF, packed[a * INDEX_ENTRY.itemsize : b * INDEX_ENTRY.itemsize]
        head = struct.pack("<BQHI", Op.MESSAGE_INDEX, 6 + len(content), channel, len(content))
        found[key >> 32].append((channel, head + content))
    return found


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


def frame(
    data: NDArray[np.uint8], table: NDArray[np.void], sequences: Counter[int], chunks: tuple[int, ...] = ()
) -> Framed:
    """Return records of the messages in data at a table's offsets, with the table's channel ids.

    sequences : next sequence number of each channel, which is counted on
    chunks : where chunks end in data; what is framed ends there, too
    """
    first_ns = table["log_ns"].min(initial=0)
    if first_ns < 0:
        raise BagError(f"log time {first_ns} ns: is before 1970, which no MCAP can have; write the input's format")
    lengths = table["length"]
    ends = np.cumsum(lengths + MESSAGE_HEADER_BYTES)
    framed = table.copy()
    framed["offset"] = ends - lengths
    heads = np.empty(table.size, dtype=MESSAGE_HEADER)
    heads["opcode"] = Op.MESSAGE
    heads["length"] = lengths + (MESSAGE_HEADER_BYTES - RECORD_HEADER_BYTES)
    heads["channel"] = table["channel"]
    for channel in set(table["channel"].tolist()):
        own = np.flatnonzero(table["channel"] == channel)
        heads["sequence"][own] = sequences[channel] + np.arange(own.size)
        sequences[channel] += own.size
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


class Packed(NamedTuple):
    """A chunk's compressed data.

    crc, packed_crc : CRC-32 of the uncompressed data, and of the compressed data
    """

    data: bytes | memoryview
    crc: int
    packed_crc: int


def packed(codec: str, data: NDArray[np.uint8], level: int | None) -> Packed:
    """Return a chunk's records compressed, with their CRC-32."""
    crc, compressed = crc32(data.data), compress(codec, data, level)
    # in the thread that has the data in its cache
    return Packed(compressed, crc, crc if codec == "none" else crc32(compressed))


class McapWriter(OutputContext):
    """An MCAP being written from the blocks of a reader of any format.

    keeps_rest : whether only messages that may change need to be read of chunks that the kernel can copy
    codec : compression of the chunks; None keeps each chunk's own
    level : compression level; None is the default of the codec
    workers : threads for compression; written blocks must then not change
    native : whether records and ids of an MCAP are kept
    whole : whether the output must contain all messages of the reader, which is then checked
    pack : compression function of chunks, default `packed`; a batch compresses common chunks once
    """

    def __init__(
        self, output: Output, reader: BagReader, codec: str | None = None, level: int | None = None, *,
        workers: Workers | None = None, native: bool = True, whole: bool = True,
    ) -> None:  # fmt: skip
        super().__init__(output, workers)
        self._reader = reader
        self._channels = ChannelTable(reader, native=native)
        self.keeps_rest = isinstance(reader, McapReader) and reader.sparse
        self._codec = codec
        self._level = level
        self._whole = whole
        self.pack = packed
        self._index = Index()
        self._sequences: Counter[int] = Counter()
        self._added_count = 0

    def add_channel(self, topic: str, msgtype: str, like: Channel, definition: Definition | None = None) -> Channel:
        """Add a channel with the encoding, QoS and latching of another one, or of a definition, under a new id."""
        return self._channels.add(topic, msgtype, like.encoding, definition or retyped(self._reader, msgtype, like))

    def contents(self) -> PartContents:
        """Return the message counts and time span written so far."""
        counts: Counter[str] = Counter()
        for channel, count in self._index.counts.items():
            counts[self._channels.topic(channel)] += count
        return PartContents(Path(self._output.name).name, counts, self._index.start_ns or 0, self._index.end_ns)

    def provenance(self, name: str, items: Mapping[str, str]) -> None:
        """Write a metadata record."""
        self._write_record(Op.METADATA, record(Op.METADATA, string(name), mapping(items)))

    def write(self, block: Block) -> None:
        """Write a block, its added messages last."""
        framing = block.raw
        kind = framing.kind if isinstance(framing, McapFraming) else "chunk"
        if kind == "record" and isinstance(framing, McapFraming):
            self._write_record(framing.opcode, block.data.data)
            if not block.added:
                return
            framed = self._added(block)
        else:
            framed = self._own(block)
            if block.added:
                framed = framed.followed_by(self._added(block))
        if kind != "chunk" and self._codec is None:
            self._index.count(framed.table)
            self._results.put_behind(partial(self._output.write, framed.data.data), framed.data.size)
        else:
            codec = self._codec or (framing.codec if framing.codec in CODECS else "zstd")
            self._write_chunks(framed, codec, block.sparse)

    def _own(self, block: Block) -> Framed:
        """Return a block's own messages as records, unchanged if they come from an MCAP with the same ids."""
        of_mcap = isinstance(block.raw, McapFraming)
        if of_mcap and self._channels.native:
            return Framed(block.data, block.table, block.ends)
        table = with_ids(block.table, self._channels.written_id)
        if of_mcap:
            records = reframe(block.data, table, block.ends)
        else:
            records = frame(block.data, table, self._sequences, block.ends)
        return self._records(table["channel"]).followed_by(records)

    def _added(self, block: Block) -> Framed:
        """Return records of a block's added messages, after those of the channels they need."""
        table = np.empty(len(block.added), dtype=TABLE)
        table["channel"] = [self._channels.written_id(one.channel) for one in block.added]
        table["log_ns"] = [one.log_ns for one in block.added]
        table["length"] = [len(one.data) for one in block.added]
        table["offset"] = np.cumsum(table["length"]) - table["length"]
        data = np.frombuffer(b"".join(one.data for one in block.added), dtype=np.uint8)
        self._added_count += len(table)
        return self._records(table["channel"]).followed_by(frame(data, table, self._sequences))

    def _records(self, channels: NDArray[np.uint32]) -> Framed:
        """Return the schema and channel records that these channels still need in the file."""
        data = self._channels.take_records(channels)
        return Framed(np.frombuffer(data, dtype=np.uint8), np.empty(0, dtype=TABLE))

    def _write_chunks(self, framed: Framed, codec: str, originals: Sequence[Original]) -> None:
        table = framed.table
        self._index.count(table)
        ends = framed.ends or (framed.data.size,)
        begins = (0, *ends[:-1])
        stops = [*np.searchsorted(table["offset"], ends[:-1]).tolist(), table.size]
        spans = [span_ns(table[start:stop]) for start, stop in zip((0, *stops), stops, strict=False)]
        rows = zip(begins, ends, spans, message_indexes(table, begins, stops), strict=True)
        for (begin, end, span, indexes), original in zip_longest(rows, originals):
            data = framed.data if len(ends) == 1 else framed.data[begin:end]
            pack = partial(self.pack, codec, data, self._level)
            if original is not None:
                crc = original.crc_with(data.data)
                pack = partial(Packed, data.data, crc, crc)
            write = partial(self._write_chunk, span, codec, data.size, indexes, original)
            self._results.put(pack, write, data.size, worth=codec != "none")

    def _write_chunk(
        self, span: tuple[int, int], codec: str, size: int, indexes: list[tuple[int, bytes]],
        original: Original | None, chunk: Packed,
    ) -> None:  # fmt: skip
        """Write a chunk of `size` bytes of records, and its message indexes."""
        position, packed_size = self._output.position, len(chunk.data)
        head = chunk_head(*span, size=size, crc=chunk.crc, codec=codec, packed=packed_size)
        self._output.write(head)
        self._output.write_summed(chunk.data, chunk.packed_crc, original)
        place = position, len(head) + packed_size
        self._output.write(self._index.add_chunk(span, codec, (packed_size, size), place, indexes))

    def _write_record(self, opcode: int, data: memoryview | bytes) -> None:
        """Write a record unchanged, or a later piece of one (opcode 0), after all pending writes."""

        def write() -> None:
            if opcode:
                self._index.add_record(opcode, bytes(data[: 1 << 20]), self._output.position)
            self._output.write(data)

        self._results.put_behind(write, len(data))

    def _finish(self) -> None:
        self._results.finish()
        output = self._output
        if self._whole:
            require_all(output.name, self._reader, self._index.counts.total(), self._added_count)
        output.write(record(Op.DATA_END, struct.pack("<I", output.crc)))
        begin = output.position
        output.restart_crc()
        private = self._channels.native.summary.private if self._channels.native else []
        section, offsets = self._index.summary(*self._channels.packed(), private, begin)
        footer = record(Op.FOOTER, struct.pack("<QQI", begin, offsets, 0))[:-4]
        output.write(section, footer)
        output.write(struct.pack("<I", output.crc), MAGIC)

    def _begin(self) -> None:
        self._output.write(MAGIC, record(Op.HEADER, self._channels.header()))

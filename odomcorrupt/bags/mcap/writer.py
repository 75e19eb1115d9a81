"""MCAP writer for files and pipes, without seeking."""

from __future__ import annotations

import struct
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.block import TABLE, PartContents, PartFraming, require_all
from odomcorrupt.bags.checksum import CAN_COMBINE, crc32
from odomcorrupt.bags.codecs import compress, require_level
from odomcorrupt.bags.mcap.channel_table import ChannelTable
from odomcorrupt.bags.mcap.chunk import CODECS, McapFraming
from odomcorrupt.bags.mcap.framing import Framed, Sequences, frame, frame_added, reframe
from odomcorrupt.bags.mcap.index import ChunkPlace, ChunkRows, ChunkSpan, Index, message_indexes, span_ns
from odomcorrupt.bags.mcap.reader import McapReader
from odomcorrupt.bags.mcap.records import (
    DATA_END,
    FOOTER,
    HEADER,
    MAGIC,
    METADATA,
    chunk_head,
    mapping,
    record,
    string,
)
from odomcorrupt.bags.output import OutputContext
from odomcorrupt.bags.pipeline import OrderedResults

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Block, Channel, Definition, Kind
    from odomcorrupt.bags.output import Original, Output
    from odomcorrupt.bags.pipeline import Workers


class Packed(NamedTuple):
    """A chunk's compressed data.

    crc, packed_crc : CRC-32 of the uncompressed data, and of the compressed data where known
    """

    data: bytes | memoryview
    crc: int
    packed_crc: int | None = None


def packed(codec: str, data: NDArray[np.uint8], level: int | None) -> Packed:
    """Return a chunk's records compressed, with their CRC-32."""
    crc = crc32(data.data)
    require_level(codec, level)
    if codec == "none":
        return Packed(data.data, crc, crc)
    compressed = compress(codec, data, level)
    # in the thread that has the data in its cache
    return Packed(compressed, crc, crc32(compressed) if CAN_COMBINE else None)


class McapWriter(OutputContext):
    """An MCAP being written from the blocks of a reader of any format.

    keeps_rest : whether messages not passed to `write` are in the output (False)
    codec : compression of the chunks; None keeps each chunk's own
    level : compression level; None is the default of the codec
    workers : threads for compression; written blocks must then not change
    whole : whether the output must contain all messages of the reader, which is then checked
    pack : compression function of chunks, default `packed`; a batch compresses common chunks once
    """

    keeps_rest = False

    def __init__(
        self,
        output: Output,
        reader: BagReader,
        codec: str | None = None,
        level: int | None = None,
        *,
        workers: Workers | None = None,
        whole: bool = True,
    ) -> None:
        self._whole = whole
        self._added_count = 0
        super().__init__(output)
        self._results = OrderedResults(workers)
        self._reader = reader
        self._codec = codec
        self._level = level
        self.pack = packed
        self._index = Index()
        self._channel_table = ChannelTable(reader)
        self._sequences = Sequences()

    def add_channel(self, topic: str, msgtype: str, like: Channel) -> Channel:
        """Add a channel with the encoding, QoS and latching of another one; return it with a new id."""
        return self._channel_table.add(topic, msgtype, like)

    def add_defined(self, topic: str, msgtype: str, encoding: str, definition: Definition) -> Channel:
        """Add a channel with a given definition; return it."""
        return self._channel_table.add_defined(topic, msgtype, encoding, definition)

    def contents(self) -> PartContents:
        """Return the message counts and time span written so far."""
        counts = {self._channel_table.topic(channel): count for channel, count in self._index.counts.items()}
        return PartContents(Path(self._output.name).name, counts, self._index.start_ns or 0, self._index.end_ns)

    def provenance(self, name: str, items: Mapping[str, str]) -> None:
        """Write a metadata record."""
        self._write_record(METADATA, record(METADATA, string(name), mapping(items)))

    def write(self, block: Block) -> None:
        """Write a block, its added messages last."""
        framing = block.raw.own.raw if isinstance(block.raw, PartFraming) else block.raw
        if isinstance(framing, McapFraming) and framing.kind == "record":
            self._write_record(framing.opcode, block.data.data)
            if not block.added:
                return
            framed = self._added(block)
        else:
            framed = self._own(block, framing)
            if block.added:
                framed = framed.followed_by(self._added(block))
        if isinstance(framing, McapFraming) and framing.kind != "chunk" and self._codec is None:
            self._index.count(framed.table)
            self._results.put_behind(partial(self._output.write, framed.data.data), framed.data.size)
        else:
            codec = getattr(framing, "codec", "zstd")
            codec = self._codec or (codec if codec in CODECS else "zstd")
            native = self._results.beside and framing is block.raw and isinstance(self._reader, McapReader)
            originals = self._reader.originals(block) if native and codec == "none" else []  # type: ignore[attr-defined]
            self._write_chunks(framed, codec, originals)

    def settle(self) -> None:
        """Wait until all blocks passed to `write` are written and may change."""
        self._results.finish()

    def _own(self, block: Block, framing: object) -> Framed:
        """Return a block's own messages as records, unchanged if they come from an MCAP."""
        native = isinstance(framing, McapFraming)
        if native and not isinstance(block.raw, PartFraming):
            return Framed(block.data, block.table, block.ends)
        table = block.table.copy()
        table["channel"] = self._channel_table.translate(table["channel"])
        if native:
            records = reframe(block.data, table, block.ends)
        else:
            records = frame(block.data, table, self._sequences, block.ends)
        return self._records(table["channel"]).followed_by(records)

    def _added(self, block: Block) -> Framed:
        """Return records of a block's added messages, after those of the channels they need."""
        messages = [one._replace(channel=self._channel_table.written_id(one.channel)) for one in block.added]
        framed = frame_added(messages, self._sequences)
        self._added_count += len(messages)
        return self._records(framed.table["channel"]).followed_by(framed)

    def _records(self, channels: NDArray[np.uint32]) -> Framed:
        """Return the schema and channel records that these channels still need in the file."""
        data = self._channel_table.take_records(channels)
        return Framed(np.frombuffer(data, dtype=np.uint8), np.empty(0, dtype=TABLE))

    def _write_chunks(self, framed: Framed, codec: str, originals: list[Original]) -> None:
        self._index.count(framed.table)
        ends = framed.ends or (framed.data.size,)
        stops = np.searchsorted(framed.table["offset"], ends[:-1]).tolist()
        rows = zip((0, *ends[:-1]), ends, (0, *stops), (*stops, framed.table.size), strict=True)
        chunks = [ChunkRows(*row) for row in rows]
        same: Sequence[Original | None] = originals or [None] * len(chunks)
        for chunk, indexes, original in zip(chunks, message_indexes(framed.table, chunks), same, strict=True):
            data = framed.data if len(chunks) == 1 else framed.data[chunk.begin : chunk.end]
            span = ChunkSpan(*span_ns(framed.table[chunk.start : chunk.stop]), codec, data.size)
            self._results.put(
                partial(self.pack, codec, data, self._level),
                partial(self._write_chunk, span, indexes, original),
                data.size,
                worth=codec != "none",
            )

    def _write_chunk(
        self, span: ChunkSpan, indexes: list[tuple[int, bytes]], original: Original | None, chunk: Packed
    ) -> None:
        """Write a chunk and its message indexes."""
        position, size = self._output.position, len(chunk.data)
        head = chunk_head(span.start_ns, span.end_ns, size=span.size, crc=chunk.crc, codec=span.codec, packed=size)
        self._output.write(head)
        if original is not None:
            self._output.write_changed(memoryview(chunk.data), chunk.crc, original)
        elif chunk.packed_crc is not None:
            self._output.write_summed(chunk.data, chunk.packed_crc)
        else:
            self._output.write(chunk.data)
        self._output.write(self._index.add_chunk(span, ChunkPlace(position, len(head) + size, size), indexes))

    def _write_record(self, opcode: int, data: memoryview | bytes) -> None:
        """Write a record unchanged, or a later piece of one (opcode 0), after all pending writes."""
        self._results.put_behind(partial(self._write_record_now, opcode, data), len(data))

    def _write_record_now(self, opcode: int, data: memoryview | bytes) -> None:
        if opcode:
            self._index.add_record(opcode, bytes(data[: 1 << 20]), self._output.position)
        self._output.write(data)

    def _finish(self) -> None:
        self._results.finish()
        output = self._output
        if self._whole:
            require_all(output.name, self._reader, sum(self._index.counts.values()), self._added_count)
        output.write(record(DATA_END, struct.pack("<I", output.crc)))
        begin = output.position
        output.restart_crc()
        private: list[bytes] = self._reader.summary.private if isinstance(self._reader, McapReader) else []
        section, offsets = self._index.summary(*self._channel_table.packed(), private, begin)
        footer = record(FOOTER, struct.pack("<QQI", begin, offsets, 0))[:-4]
        output.write(section, footer)
        output.write(struct.pack("<I", output.crc), MAGIC)

    def _begin(self) -> None:
        self._output.write(MAGIC, record(HEADER, self._channel_table.header()))


class ReframedReader:
    """A reader of an MCAP presented as one of another format, so that a writer frames its messages itself."""

    complete = True

    def __init__(self, reader: BagReader) -> None:
        ros1 = all(channel.encoding == "ros1" for channel in reader.channels.values())
        self.kind: Kind = "ros1" if ros1 else "sqlite3"
        self.name, self.paths, self.channels = reader.name, reader.paths, reader.channels
        self.definition, self.blocks = reader.definition, reader.blocks
        self._reader = reader

    @property
    def count(self) -> int:
        """Number of messages of the last pass."""
        return self._reader.count

    @property
    def losses(self) -> list[str]:
        """Parts that could not be read, one sentence each."""
        return self._reader.losses

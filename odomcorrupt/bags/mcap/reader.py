"""Read an MCAP as blocks: one per chunk, messages outside chunks in batches, everything else as it stands."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Self

import numpy as np

from odomcorrupt.bags.block import Block, Channel
from odomcorrupt.bags.definition import Definition
from odomcorrupt.bags.losses import loss_of
from odomcorrupt.bags.mcap.chunk import Chunk, Loose, McapFraming, read_chunk, read_pieces
from odomcorrupt.bags.mcap.contents import read_contents
from odomcorrupt.bags.mcap.records import (
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    RECORD_HEADER_BYTES,
    SCHEMA,
    ChannelRecord,
    SchemaRecord,
)
from odomcorrupt.bags.mcap.summary import Summary, read_summary
from odomcorrupt.bags.source import Source
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Mapping
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Kind

__all__ = ["McapReader"]

_BATCH_BYTES = 1 << 20
_LOOSE = (MESSAGE, SCHEMA, CHANNEL)
_ENDS = (DATA_END, FOOTER)


class McapReader:
    """An MCAP file or pipe.

    header : content of the header record
    schemas : by id
    summary : what the summary section had; of a pipe, known when the blocks are read
    losses : what could not be read, one sentence each, where recovery was asked for
    """

    kind: Kind = "mcap"

    def __init__(self, path: Path | None, source: Source, *, recover: bool = False) -> None:
        self.name = source.name
        self.paths = [] if path is None else [path]
        self.complete = path is not None and source.size is not None
        self._channels: dict[int, Channel] = {}
        self.channels: Mapping[int, Channel] = self._channels
        self.schemas: dict[int, SchemaRecord] = {}
        self.summary = Summary()
        self.losses: list[str] = []
        self._recover = recover
        self._source = source
        self.header = self._read_header(source)
        self._data_start = source.position
        self._begun = False
        if self.complete and source.size is not None:
            try:
                self.summary = read_summary(source, source.size)
            except BagError:
                # What is lost shows when the blocks are read; here it is only the way to the channels.
                if not recover:
                    raise
            self._learn_all()

    def definition(self, channel: Channel) -> Definition:
        """Return what the file says of a channel's type."""
        raw: ChannelRecord = channel.raw
        schema = self.schemas.get(raw.schema, SchemaRecord(0, "", "", b""))
        return Definition(schema.name, schema.encoding, schema.data, raw.metadata)

    def blocks(self, only: Container[int] | None = None) -> Iterator[Block]:  # noqa: ARG002 - all is as cheap
        """Yield the blocks in file order; of a file as often as asked for, of a pipe once."""
        self.losses.clear()
        if not self.complete:
            if self._begun:
                raise BagError(f"{self.name}: a pipe can be read once only; write it to a file first")
            self._begun = True
            yield from self._blocks(self._source)
            try:
                self._finish(self._source)
            except BagError as error:
                self._lose(error)
            return
        with Source.of_file(self.paths[0]) as source:
            source.seek(self._data_start)
            yield from self._blocks(source)

    def _blocks(self, source: Source) -> Iterator[Block]:
        pending: Chunk | Loose | None = None
        for opcode, length, what in self._records(source):
            if pending and not _continues(pending, opcode):
                done, pending = pending, None
                yield from self._finished(done)
            end = source.position + length
            try:
                if opcode in _LOOSE and pending is None:
                    pending = Loose()
                if pending:
                    pending.append(opcode, source.read(length, what), f"{self.name}: {what}")
                elif opcode == CHUNK:
                    pending = read_chunk(source, length, what)
                else:
                    yield from _alone(source, opcode, length, what)
            except BagError as error:
                self._lose(error)
                if not source.skip_to(end):
                    break
        if pending:
            yield from self._finished(pending)

    def _records(self, source: Source) -> Iterator[tuple[int, int, str]]:
        """Yield opcode, length and name of the data section's records, whose contents are read by the caller."""
        opcode, length, what = 0, 0, ""
        try:
            while opcode not in _ENDS:
                what = f"record at byte {source.position}"
                opcode, length = struct.unpack("<BQ", source.read(RECORD_HEADER_BYTES, what))
                yield opcode, length, what
            source.read(length, what)
        except BagError as error:
            self._lose(error)

    def _finished(self, part: Chunk | Loose) -> Iterator[Block]:
        try:
            yield self._chunk_block(part) if isinstance(part, Chunk) else self._loose_block(part)
        except BagError as error:
            self._lose(error)

    def _lose(self, error: BagError) -> None:
        """Note what cannot be read, or give up where that was not asked for."""
        if not self._recover:
            raise error
        self.losses.append(loss_of(error))

    def _chunk_block(self, chunk: Chunk) -> Block:
        contents = read_contents(chunk.data, chunk.indexes, chunk.what)
        for other in contents.others:
            if other.opcode in (SCHEMA, CHANNEL):
                self._learn(other.opcode, chunk.data[other.start : other.end].tobytes())
        self._require_channels(contents.table, chunk.what)
        return Block(chunk.data, contents.table, McapFraming("chunk", chunk.codec))

    def _loose_block(self, loose: Loose) -> Block:
        for opcode, content in loose.others:
            self._learn(opcode, content)
        block = loose.block()
        self._require_channels(block.table, f"{self.name}: messages outside chunks")
        return block

    def _require_channels(self, table: NDArray[np.void], what: str) -> None:
        unknown = set(np.unique(table["channel"]).tolist()) - self.channels.keys()
        if unknown:
            raise BagError(f"{what}: messages of channel {min(unknown)}, which the bag does not define; damaged bag")

    def _learn(self, opcode: int, content: bytes) -> None:
        """Take note of a schema or channel; the first one of an id counts, later ones must be equal anyway."""
        if opcode == SCHEMA:
            schema = SchemaRecord.parse(content, self.name)
            self.schemas.setdefault(schema.id, schema)
            return
        channel = ChannelRecord.parse(content, self.name)
        if channel.schema and channel.schema not in self.schemas:
            raise BagError(
                f"{self.name}: {channel.topic} has schema {channel.schema}, which is not defined; damaged bag"
            )
        name = self.schemas[channel.schema].name if channel.schema else ""
        package, _, leaf = name.partition("/")
        msgtype = f"{package}/msg/{leaf}" if leaf and "/" not in leaf else name
        self._channels.setdefault(
            channel.id, Channel(channel.id, channel.topic, msgtype, channel.encoding, raw=channel)
        )

    def _learn_all(self) -> None:
        """Learn every channel of a file: from its summary, or from its data where the summary does not tell all."""
        for schema in self.summary.schemas:
            self._learn(SCHEMA, schema)
        for channel in self.summary.channels:
            self._learn(CHANNEL, channel)
        if len(self.channels) != self.summary.channel_count:
            for _ in self.blocks():
                if len(self.channels) == self.summary.channel_count:
                    break

    def _read_header(self, source: Source) -> bytes:
        if source.read(len(MAGIC), "magic") != MAGIC:
            raise BagError(f"{self.name}: does not begin as an MCAP does")
        opcode, length = struct.unpack("<BQ", source.read(RECORD_HEADER_BYTES, "header"))
        if opcode != HEADER:
            raise BagError(f"{self.name}: its first record is {opcode:#04x}, not a header; the bag is damaged")
        return source.read(length, "header")

    def _finish(self, source: Source) -> None:
        """Read a pipe to its end: the summary, and that there is one tells that nothing was cut."""
        if source.sniff(len(MAGIC)) == MAGIC:
            return
        opcode = DATA_END
        while opcode != FOOTER:
            opcode, length = struct.unpack("<BQ", source.read(RECORD_HEADER_BYTES, "summary"))
            self.summary.keep(opcode, source.read(length, "summary"), self.name)
        if source.read(len(MAGIC), "magic at the end") != MAGIC:
            raise BagError(f"{self.name}: does not end as an MCAP does; the bag is damaged")

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._source.close()


def _alone(source: Source, opcode: int, length: int, what: str) -> Iterator[Block]:
    """Yield a record that stands alone; the end has no content of use, an index without its chunk is rebuilt."""
    if opcode == MESSAGE_INDEX:
        source.read(length, what)
    elif opcode not in _ENDS:
        yield from read_pieces(source, opcode, length, what)


def _continues(pending: Chunk | Loose, opcode: int) -> bool:
    """Tell whether a record belongs to what is being collected."""
    if isinstance(pending, Chunk):
        return opcode == MESSAGE_INDEX
    return opcode in _LOOSE and len(pending.data) < _BATCH_BYTES

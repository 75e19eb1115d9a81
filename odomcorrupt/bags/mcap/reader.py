"""MCAP reader: one block per chunk, messages outside chunks in batches, other records unchanged."""

from __future__ import annotations

import struct
from contextlib import closing
from dataclasses import replace
from typing import TYPE_CHECKING, Self

from odomcorrupt.bags.block import Block
from odomcorrupt.bags.chunk import Chunk, beginning_of_chunk, read_chunks
from odomcorrupt.bags.mcap.chunk import Loose, read_chunk_head, read_pieces
from odomcorrupt.bags.mcap.chunk_messages import record_bytes
from odomcorrupt.bags.mcap.records import (
    ATTACHMENT,
    CHANNEL,
    CHUNK,
    DATA_END,
    FOOTER,
    HEADER,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    RECORD_HEADER_BYTES,
    SCHEMA,
    string,
)
from odomcorrupt.bags.mcap.resync import (
    loss_of_cut_chunk,
    next_record,
    stands_behind,
    stands_here,
    whole_records,
    without,
)
from odomcorrupt.bags.mcap.schema_registry import Known
from odomcorrupt.bags.mcap.section_checksums import (
    FOOTER_BYTES,
    require_data_crc,
    require_summary_crc,
    stated_data_crc,
)
from odomcorrupt.bags.mcap.summary import Summary, read_summary, require_named
from odomcorrupt.bags.pipeline import read_ahead
from odomcorrupt.bags.recovery_report import Undecodable, loss_of
from odomcorrupt.bags.source import Source
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Generator, Iterator, Mapping
    from pathlib import Path
    from types import TracebackType

    from odomcorrupt.bags.block import Channel, Kind
    from odomcorrupt.bags.definition import Definition
    from odomcorrupt.bags.mcap.records import SchemaRecord

__all__ = ["McapReader"]

_BATCH_BYTES = 1 << 20
_NAMES_BYTES = 1 << 16
"""How much of an attachment is looked at."""
_LOOSE = (MESSAGE, SCHEMA, CHANNEL)
_ENDS = (DATA_END, FOOTER)
_DATA = (CHUNK, MESSAGE, MESSAGE_INDEX, ATTACHMENT, METADATA)
"""Records that have no place behind the end of the data section."""


class McapReader:
    """An MCAP file or pipe.

    header : content of the header record
    schemas : by id
    summary : content of the summary section; on a pipe, after the blocks are read
    losses : parts that could not be read, one sentence each, with recovery
    count : number of messages of the last pass
    """

    kind: Kind = "mcap"

    def __init__(self, path: Path | None, source: Source, *, recover: bool = False, threads: int = 1) -> None:
        self.name = source.name
        self.paths = [] if path is None else [path]
        self.complete = path is not None and source.size is not None
        self._known = Known(self.name)
        self.channels: Mapping[int, Channel] = self._known.channels
        self.schemas: Mapping[int, SchemaRecord] = self._known.schemas
        self.summary = Summary()
        self.losses: list[str] = []
        self._recover = recover
        self._threads = threads
        self._source = self._reading = source
        self._first_losses = 0
        self._undecodable = Undecodable()
        try:
            self.header = self._read_header(source)
        except BagError as error:
            if not recover or source.position < len(MAGIC):
                raise
            self._lose(error)
            self._first_losses = 1
            self.header = string("") + string("")
            next_record(source, len(MAGIC))
        if recover and not self._first_losses and not stands_here(source):
            self.losses.append(f"{self.name}: its header is not as long as it says")
            self._first_losses = 1
            next_record(source, len(MAGIC))
        self._data_start = source.position
        self._begun = False
        self.count = 0
        if source.size is not None and (self.complete or recover):
            try:
                self.summary = read_summary(source, source.size)
                self._learn_summary()
            except BagError:
                # Losses are reported when the blocks are read; this pass is for the channels only.
                if not recover:
                    raise
            if self.complete:
                self._learn_all()
            else:
                source.seek(self._data_start)

    def definition(self, channel: Channel) -> Definition:
        """Return the file's definition of a channel's type."""
        return self._known.definition(channel)

    @property
    def part_read(self) -> float | None:
        """Part of the file's bytes read in this pass, 0 to 1; None where its size is unknown."""
        return self._reading.position / self._reading.size if self._reading.size else None

    def blocks(self, only: Container[int] | None = None) -> Iterator[Block]:  # noqa: ARG002 - all is as cheap
        """Yield the blocks in file order; repeatable for a file, once for a pipe."""
        del self.losses[self._first_losses :]
        self._undecodable = Undecodable()
        self.count = 0
        if self.complete:
            with Source.of_file(self.paths[0]) as source:
                self._reading = source
                source.seek(self._data_start)
                yield from self._blocks(source)
        else:
            if self._begun:
                raise BagError(f"{self.name}: a pipe can be read once only; write it to a file first")
            self._begun = True
            yield from self._blocks(self._source)
        self.losses += self._undecodable.losses(self.name)
        stated = self.summary.message_count
        if stated is not None and self.count < stated and not self.losses:
            self._lose(
                BagError(
                    f"{self.name}: its statistics tell of {stated} messages, {self.count} are there: the bag is "
                    "damaged; --recover saves those"
                )
            )

    def _blocks(self, source: Source) -> Iterator[Block]:
        """Yield the blocks of a source, and register channels on the way."""
        source.crc = 0
        source.summing = self.summary.has_data_crc and not self._recover
        parts: Iterator[Chunk | Loose | Block] = self._parts(source)
        if self._threads > 1 and self.complete and not self._recover:
            parts = read_ahead(self._parts(source), lambda part: len(part.data))
        with closing(parts):  # type: ignore[type-var] # both are generators
            for part in parts:
                if isinstance(part, Block):
                    yield part
                else:
                    yield from self._finished(part)
        if not self.complete and not self._recover:
            self._learn_summary()

    def _parts(self, source: Source) -> Generator[Chunk | Loose | Block, None, None]:
        """Yield chunks, collected messages outside chunks, and single records."""
        pending: Chunk | Loose | Block | None = None
        for opcode, length, what in self._records(source):
            if pending and not _continues(pending, opcode):
                done, pending = pending, None
                yield done
            begin = source.position - RECORD_HEADER_BYTES
            try:
                if opcode in _LOOSE and pending is None:
                    pending = Loose()
                if isinstance(pending, Chunk | Loose):
                    pending.append(opcode, source.read(length, what), f"{self.name}: {what}")
                    continue
                for part in self._single(source, opcode, length, what):
                    if pending:
                        yield pending
                    pending = part
            except BagError as error:
                self._lose(error)
                if not (
                    source.skip_to(begin + RECORD_HEADER_BYTES + length) and stands_behind(source, begin, failed=True)
                ):
                    next_record(source, begin)
        if pending:
            yield pending

    def _single(self, source: Source, opcode: int, length: int, what: str) -> Iterator[Chunk | Block]:
        """Yield a record that is not collected with others; the footer and indexes without chunks are skipped."""
        if opcode == MESSAGE_INDEX:
            source.read(length, what)
        elif opcode == CHUNK and self._recover and source.position + length > (source.size or 0):
            self.losses.append(loss_of_cut_chunk(source, length, what))
            for chunk in beginning_of_chunk(source, read_chunk_head(source, length, what), record_bytes):
                yield replace(chunk, data=whole_records(chunk.data))
        elif opcode == CHUNK:
            source.require(length, what)
            yield from read_chunks(source, read_chunk_head(source, length, what), record_bytes, verify=self._recover)
        elif opcode not in _ENDS:
            summed = 0
            if opcode in (ATTACHMENT, METADATA):
                summed = require_named(opcode, source.sniff(min(length, _NAMES_BYTES)), f"{self.name}: {what}")
            yield from read_pieces(source, opcode, length, what, summed)

    def _records(self, source: Source) -> Iterator[tuple[int, int, str]]:
        """Yield opcode, length and name of the data section's records, whose contents are read by the caller."""
        opcode, length, what, last = 0, 0, "", source.position
        try:
            while opcode not in _ENDS:
                what = f"record at byte {source.position}"
                if self._recover and not (stands_behind(source, last) if opcode == CHUNK else stands_here(source)):
                    self.losses.append(f"{self.name}: {what} is none: the bag is truncated or damaged")
                    if not next_record(source, last):
                        return
                    what = f"record at byte {source.position}"
                last, crc = source.position, source.crc
                opcode, length = struct.unpack("<BQ", source.read(RECORD_HEADER_BYTES, what))
                if opcode not in _ENDS:
                    yield opcode, length, what
                elif self._ends(source, opcode, length, what, crc):
                    return
                else:
                    opcode = 0
        except BagError as error:
            self._lose(error)

    def _ends(self, source: Source, opcode: int, length: int, what: str, crc: int) -> bool:
        """Read the end of the data section; return whether it is the end, or seek to further data behind it.

        crc : CRC-32 of the data section, if the source computes it
        """
        content = source.read(length, what)
        private: list[bytes] = []
        end = source.position
        if opcode == DATA_END:
            self._check_data_crc(source, content, crc, f"{self.name}: {what}")
            source.crc, source.summing = 0, True
        try:
            while opcode != FOOTER:
                if source.sniff(len(MAGIC)) == MAGIC:
                    break
                begin, crc = source.position, source.crc
                what = f"record at byte {begin}"
                opcode, length = struct.unpack("<BQ", source.read(RECORD_HEADER_BYTES, what))
                if opcode in _DATA:
                    self._lose(BagError(f"{self.name}: {what} is data behind the data's end; the bag is damaged"))
                    source.seek(begin)
                    return False
                content = source.read(length, what)
                if (opcode, length) == (FOOTER, FOOTER_BYTES) and int.from_bytes(content[:8], "little") == end:
                    require_summary_crc(content, crc, self.name)
                self.summary.keep(opcode, content, self.name, private)
            if source.read(len(MAGIC), "magic at the end") != MAGIC:
                raise BagError(f"{self.name}: does not end as an MCAP does; the bag is damaged")  # noqa: TRY301
        except BagError as error:
            self._lose(error)
            # A false end: there may be data behind it.
            if next_record(source, end - 1, _DATA):
                return False
        self.summary.private = private
        return True

    def _check_data_crc(self, source: Source, content: bytes, crc: int, what: str) -> None:
        """Record or raise a loss where the checksum in a DataEnd record that was just read is wrong."""
        end = source.position
        length = end - len(content) - RECORD_HEADER_BYTES - self._data_start
        try:
            stated = stated_data_crc(content, what)
            if not stated or self.losses or not (source.summing or self._recover):
                return
            if self._recover:
                # recovery goes back and forth: what it read has no sum
                source.seek(self._data_start)
                source.crc, source.summing = 0, True
                source.skim(length, what)
                crc = source.crc
                source.seek(end)
            require_data_crc(stated, crc, length, self.header, self.name)
        except BagError as error:
            self._lose(error)

    def _finished(self, part: Chunk | Loose) -> Iterator[Block]:
        try:
            block = self._known.block(part)
        except BagError as error:
            self._lose(error)
            block = self._known.salvaged(part)
        if self._recover:
            block = without(block, self._undecodable.find(block, self.channels))
        self.count += len(block.table)
        yield block

    def _lose(self, error: BagError) -> None:
        """Record a loss with recovery, else raise the error."""
        if not self._recover:
            raise error
        self.losses.append(loss_of(error))

    def _learn_summary(self) -> None:
        """Register the channels of the summary; those without a schema there are read from the data section."""
        for schema in self.summary.schemas:
            self._known.learn(SCHEMA, schema)
        for channel in self.summary.channels:
            if self._known.defines(channel):
                self._known.learn(CHANNEL, channel)

    def _learn_all(self) -> None:
        """Register the channels of a file that its summary lacks."""
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

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._source.close()


def _continues(pending: Chunk | Loose | Block, opcode: int) -> bool:
    """Return whether a record belongs to the part being collected."""
    if isinstance(pending, Chunk):
        return opcode == MESSAGE_INDEX
    return isinstance(pending, Loose) and opcode in _LOOSE and len(pending.data) < _BATCH_BYTES

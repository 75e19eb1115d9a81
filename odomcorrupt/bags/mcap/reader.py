"""MCAP reader: one block per chunk, messages outside chunks in batches, other records unchanged."""

from __future__ import annotations

import struct
from dataclasses import replace
from typing import TYPE_CHECKING

from odomcorrupt.bags.block import Block
from odomcorrupt.bags.chunk import Chunk, beginning_of_chunk, read_chunks
from odomcorrupt.bags.magic import ZSTD
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
)
from odomcorrupt.bags.mcap.schema_registry import SchemaRegistry
from odomcorrupt.bags.mcap.section_checksums import (
    FOOTER_BYTES,
    require_data_crc,
    require_summary_crc,
    stated_data_crc,
)
from odomcorrupt.bags.mcap.summary import Summary, read_summary, require_named
from odomcorrupt.bags.record_reader import RecordReader
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from odomcorrupt.bags.block import Channel, Definition, Kind
    from odomcorrupt.bags.mcap.records import SchemaRecord
    from odomcorrupt.bags.source import Source

_BATCH_BYTES = 1 << 20
_NAMES_BYTES = 1 << 16
"""How much of an attachment is looked at."""
_LOOSE = (MESSAGE, SCHEMA, CHANNEL)
_ENDS = (DATA_END, FOOTER)
_DATA = (CHUNK, MESSAGE, MESSAGE_INDEX, ATTACHMENT, METADATA)
"""Records that have no place behind the end of the data section."""


class McapReader(RecordReader):
    """An MCAP file or pipe.

    header : content of the header record
    schemas : by id
    summary : content of the summary section; on a pipe, after the blocks are read
    """

    kind: Kind = "mcap"
    _stated_by = "statistics record states"

    def __init__(self, path: Path | None, source: Source, *, recover: bool = False) -> None:
        super().__init__(path, source, recover=recover)
        self._registry = SchemaRegistry(self.name)
        self.channels: Mapping[int, Channel] = self._registry.channels
        self.schemas: Mapping[int, SchemaRecord] = self._registry.schemas
        self.summary = Summary()
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
            self.losses.append(f"{self.name}: its header does not have the stated length")
            self._first_losses = 1
            next_record(source, len(MAGIC))
        self._data_start = source.position
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

    @property
    def packed(self) -> bool:
        """Whether the messages of a file are compressed one by one, as the first one shows: no CDR begins as zstd."""
        for block in self.blocks() if self.complete else ():
            for channel, _, offset, _ in block.table[:1].tolist():
                return (
                    self.channels[channel].encoding == "cdr"
                    and block.data[offset : offset + len(ZSTD)].tobytes() == ZSTD
                )
        return False

    def definition(self, channel: Channel) -> Definition:
        """Return the file's definition of a channel's type."""
        return self._registry.definition(channel)

    def _parts(self, source: Source) -> Iterator[Chunk | Loose | Block]:
        """Yield chunks, collected messages outside chunks, and single records."""
        source.crc = 0
        source.summing = self.summary.has_data_crc and not self._recover
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
                    self.losses.append(f"{self.name}: {what} is invalid: the bag is truncated or damaged")
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
                    self._lose(
                        BagError(f"{self.name}: {what} lies after the end of the data section; the bag is damaged")
                    )
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

    def _taken(self, part: Chunk | Loose | Block) -> Block:
        return part if isinstance(part, Block) else self._finished(part)

    def _block(self, part: Chunk | Loose) -> Block:
        return self._registry.block(part)

    def _salvaged(self, part: Chunk | Loose) -> Block:
        return self._registry.salvaged(part)

    def _read_end(self, source: Source) -> None:  # noqa: ARG002 - it is read with the data section
        self._learn_summary()

    @property
    def _stated_count(self) -> int | None:
        return self.summary.message_count

    def _learn_summary(self) -> None:
        """Register the channels of the summary; those without a schema there are read from the data section."""
        for schema in self.summary.schemas:
            self._registry.register(SCHEMA, schema)
        for channel in self.summary.channels:
            if self._registry.defines(channel):
                self._registry.register(CHANNEL, channel)

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


def _continues(pending: Chunk | Loose | Block, opcode: int) -> bool:
    """Return whether a record belongs to the part being collected."""
    if isinstance(pending, Chunk):
        return opcode == MESSAGE_INDEX
    return isinstance(pending, Loose) and opcode in _LOOSE and len(pending.data) < _BATCH_BYTES

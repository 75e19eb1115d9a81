"""MCAP reader: one block per chunk, messages outside chunks in batches, other records unchanged; checksums, summary."""

from __future__ import annotations

import struct
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from mcap.opcode import Opcode as Op

from odomcorrupt.bags.block import Block, Channel, Definition
from odomcorrupt.bags.checksum import combined, crc32
from odomcorrupt.bags.chunk import BATCH_BYTES, MOST_RECORDS, Chunk, beginning_of_chunk, read_chunks
from odomcorrupt.bags.mcap.chunk import (
    CODECS,
    MESSAGE_HEADER_BYTES,
    RECORD_HEADER_BYTES,
    ChannelRecord,
    Fields,
    McapFraming,
    SchemaRecord,
    read_chunk_head,
    read_contents,
    read_pieces,
    record,
    record_bytes,
    string,
)
from odomcorrupt.bags.record_reader import WINDOW_BYTES, RecordReader
from odomcorrupt.bags.source import MCAP as MAGIC
from odomcorrupt.bags.source import ZSTD
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Kind
    from odomcorrupt.bags.source import Source


_LOOK_BYTES = 256
_FARTHEST = 10
"""Number of following records examined to accept one."""
_ADDED_BYTES = 32
"""Fields that later versions may append to a record; no other record has room in them."""
_SHORTEST_MESSAGE = MESSAGE_HEADER_BYTES - RECORD_HEADER_BYTES
_FIELDS = {
    Op.SCHEMA: (2, (4, 4, 4), 0),
    Op.CHANNEL: (4, (4, 4, 4), 0),
    Op.MESSAGE_INDEX: (2, (4,), 0),
    Op.ATTACHMENT: (16, (4, 4, 8), 4),
    Op.METADATA: (0, (4, 4), 0),
}
"""Of a record's content: the bytes before fields with a length of their own, the widths of these, the bytes behind."""
_EXACT = {Op.DATA_END: 4, Op.FOOTER: 20}
FOOTER_BYTES = _EXACT[Op.FOOTER]
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
PRIVATE = 0x80
"""Opcodes from here on belong to applications."""


def stands_here(source: Source) -> bool:
    """Return whether the next bytes are a plausible record of the data section, or its end."""
    head, here = source.sniff(_LOOK_BYTES), source.position
    if not _believable(head, 0, _left(source)):
        return False
    if head[0] < PRIVATE:
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
        window = source.sniff(WINDOW_BYTES + _LOOK_BYTES)
        data, left = np.frombuffer(window, dtype=np.uint8), _left(source)
        count = min(WINDOW_BYTES, end - begin, data.size - RECORD_HEADER_BYTES + 1)
        if count <= 0:
            return
        # lengths are less than 2^40, so three of their bytes are zero
        quiet = (data[6 : 6 + count] | data[7 : 7 + count] | data[8 : 8 + count]) == 0
        for at in np.flatnonzero(quiet & (data[:count] > 1) & (data[:count] <= Op.DATA_END)).tolist():
            if window[at] in kinds and _believable(window, at, left - at) and _chained(source, begin + at):
                yield begin + at, begin + at + RECORD_HEADER_BYTES + int.from_bytes(window[at + 1 : at + 9], "little")
        begin += WINDOW_BYTES


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
        seen += opcode < PRIVATE
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
    return bool(opcode >= PRIVATE or (opcode == Op.MESSAGE and length >= _SHORTEST_MESSAGE))


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


_ADVICE = "outside of its chunks the bag is damaged; --recover saves the intact part"


def require_data_crc(stated: int, crc: int, length: int, header: bytes, what: str) -> None:
    """Raise BagError where the data section's checksum is not that of its bytes.

    Writers sum from the first byte of the file; two other readings of the specification, in which the magic or the
    header is no part of the data section, are accepted, too.

    stated : what the file says
    crc, length : CRC-32 of the bytes between the header and the DataEnd record, and their number
    header : content of the header record
    what : name in the error
    """
    begin = record(Op.HEADER, header)
    before = (crc32(MAGIC + begin), crc32(begin))
    if stated not in (0, crc, *(combined(one, crc, length) for one in before)):
        raise BagError(f"{what}: the checksum of all its data does not match its bytes: {_ADVICE}")


def require_summary_crc(footer: bytes, crc: int, what: str) -> None:
    """Raise BagError where a footer's content states a checksum that is not that of the section before it.

    footer : content of the footer record
    crc : CRC-32 of the bytes from the section's beginning to the footer
    what : name in the error
    """
    stated = int.from_bytes(footer[16:FOOTER_BYTES], "little")
    if stated not in (0, crc32(struct.pack("<BQ", Op.FOOTER, len(footer)) + footer[:16], crc)):
        raise BagError(f"{what}: the checksum of its summary does not match its bytes: {_ADVICE}")


_END_OF_DATA = struct.pack("<BQI", Op.DATA_END, 4, 0)
"""Of a data section without a checksum."""


@dataclass(slots=True, eq=False, repr=False)
class Summary:
    """Content of a summary section.

    schemas, channels : contents of the records repeated there
    channel_count, message_count : from the statistics, or None without them
    private : whole records of applications
    has_data_crc : whether the data section may have a checksum: False if it is known to have none
    """

    schemas: list[bytes] = field(default_factory=list)
    channels: list[bytes] = field(default_factory=list)
    channel_count: int | None = None
    message_count: int | None = None
    private: list[bytes] = field(default_factory=list)
    has_data_crc: bool = True

    def keep(self, opcode: int, content: bytes, what: str, private: list[bytes] | None = None) -> None:
        """Add a record of the summary section if it is needed; private ones to a separate list."""
        if opcode == Op.SCHEMA:
            self.schemas.append(content)
        elif opcode == Op.CHANNEL:
            self.channels.append(content)
        elif opcode == Op.STATISTICS:
            fields = Fields(content, what)
            self.message_count = fields.number("Q")
            fields.number("H")
            self.channel_count = fields.number("I")
        elif opcode >= PRIVATE:
            (self.private if private is None else private).append(struct.pack("<BQ", opcode, len(content)) + content)


def require_named(opcode: int, head: bytes, what: str) -> int:
    """Return the length of an attachment without its checksum, bytes; 0 for metadata, which have none.

    head : its content, or the beginning of it

    Raises
    ------
    BagError
        If it does not start with the fields that its index requires.
    """
    fields = Fields(head, what)
    if opcode != Op.ATTACHMENT:
        fields.string()
        return 0
    times, names = (fields.number("Q"), fields.number("Q")), (fields.blob(), fields.blob())
    return 8 * len(times) + sum(4 + len(name) for name in names) + 8 + fields.number("Q")


def read_summary(source: Source, size: int) -> Summary:
    """Return the summary of a file of this size in bytes; empty if absent or senseless, since it is rebuilt anyway.

    Raises
    ------
    BagError
        If the file has no footer (it was truncated, or never closed), or the summary's checksum is wrong.
    """
    tail_bytes = RECORD_HEADER_BYTES + FOOTER_BYTES + len(MAGIC)
    if size >= tail_bytes + len(MAGIC):
        source.seek(size - tail_bytes)
        tail = source.read(tail_bytes, "footer")
        opcode, length = struct.unpack_from("<BQ", tail)
        if tail.endswith(MAGIC) and (opcode, length) == (Op.FOOTER, FOOTER_BYTES):
            return _read_section(source, tail[RECORD_HEADER_BYTES : -len(MAGIC)], size - tail_bytes)
    raise BagError(
        f"{source.name}: the file of {size} bytes has no MCAP footer at its end: it is truncated or was never closed; "
        "--recover saves the intact part"
    )


def _read_section(source: Source, footer: bytes, end: int) -> Summary:
    """Return the summary that a footer's content tells of, which ends at byte `end`."""
    summary = Summary()
    start = int.from_bytes(footer[:8], "little") or end
    if not len(MAGIC) < start <= end:
        return summary
    before = max(start - len(_END_OF_DATA), len(MAGIC))
    source.seek(before)
    summary.has_data_crc = source.read(start - before, "end of the data") != _END_OF_DATA
    if start == end:
        return summary
    section = source.read(end - start, "summary")
    require_summary_crc(footer, crc32(section), source.name)
    at = 0
    while at < len(section):
        content = at + RECORD_HEADER_BYTES
        after = content + int.from_bytes(section[at + 1 : content], "little")
        if after > len(section):
            return Summary()
        summary.keep(section[at], section[content:after], source.name)
        at = after
    return summary


_NAMES_BYTES = 1 << 16
"""How much of an attachment is looked at."""
_LOOSE = (Op.MESSAGE, Op.SCHEMA, Op.CHANNEL)
_ENDS = (Op.DATA_END, Op.FOOTER)
_MESSAGE_INDEX = bytes([Op.MESSAGE_INDEX])
_DATA = (Op.CHUNK, Op.MESSAGE, Op.MESSAGE_INDEX, Op.ATTACHMENT, Op.METADATA)
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
        self._channels: dict[int, Channel] = {}
        self.channels: Mapping[int, Channel] = self._channels
        self.schemas: dict[int, SchemaRecord] = {}
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
                self.stated = self.summary.message_count
                self._read_end(source)
            except BagError:
                # Losses are reported when the blocks are read; this pass is for the channels only.
                if not recover:
                    raise
            if not self.complete:
                source.seek(self._data_start)
            elif len(self.channels) != self.summary.channel_count:  # its summary lacks some
                any(len(self.channels) == self.summary.channel_count for _ in self.blocks())

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
        raw: ChannelRecord = channel.raw
        schema = self.schemas.get(raw.schema, SchemaRecord(0, "", "", b""))
        return Definition(schema.name, schema.encoding, schema.data, raw.metadata)

    def _register(self, opcode: int, content: bytes) -> None:
        """Register a schema or channel; a repetition must be identical."""
        if opcode == Op.SCHEMA:
            schema = SchemaRecord.parse(content, self.name)
            if self.schemas.setdefault(schema.id, schema) != schema:
                raise BagError(f"{self.name}: schema {schema.id} is defined twice, differently; damaged bag")
            return
        channel = ChannelRecord.parse(content, self.name)
        if channel.id in self.channels and self.channels[channel.id].raw != channel:
            topics = f"{self.channels[channel.id].topic} and {channel.topic}"
            raise BagError(f"{self.name}: channel {channel.id} is defined twice, differently ({topics}); damaged bag")
        if channel.schema and channel.schema not in self.schemas:
            raise BagError(f"{self.name}: {channel.topic} has schema {channel.schema}, not defined; damaged bag")
        name = self.schemas[channel.schema].name if channel.schema else ""
        package, _, leaf = name.partition("/")
        msgtype = f"{package}/msg/{leaf}" if leaf and "/" not in leaf else name
        known = Channel(channel.id, channel.topic, msgtype, channel.encoding, raw=channel)
        self._channels.setdefault(channel.id, known)

    def _parts(self, source: Source) -> Iterator[Chunk | Block]:
        """Yield chunks, collected messages outside chunks, and single records."""
        source.crc = 0
        source.summing = self.summary.has_data_crc and not self._recover
        pending: Chunk | Block | None = None
        for opcode, length, what in self._records(source):
            if pending and not _continues(pending, opcode):
                done, pending = pending, None
                yield done
            begin = source.position - RECORD_HEADER_BYTES
            try:
                if opcode == Op.MESSAGE_INDEX or opcode in _LOOSE:
                    pending = self._collected(pending, opcode, source.read(length, what), what)
                    continue
                for part in self._single(source, opcode, length, what):
                    if pending:
                        yield pending
                    pending = part
                if opcode == Op.CHUNK and not self._recover and isinstance(pending, Chunk):
                    _add_indexes(pending, source)
            except BagError as error:
                self._lose(error)
                if not (
                    source.skip_to(begin + RECORD_HEADER_BYTES + length) and stands_behind(source, begin, failed=True)
                ):
                    next_record(source, begin)
        if pending:
            yield pending

    def _collected(self, pending: Chunk | Block | None, opcode: int, content: bytes, what: str) -> Chunk | Block | None:
        """Return a chunk with an index added, or records outside of chunks with another one."""
        if opcode == Op.MESSAGE_INDEX:
            if isinstance(pending, Chunk):  # else there is no chunk for it
                pending.indexes.append((0, content))
            return pending
        if opcode == Op.MESSAGE and len(content) < _SHORTEST_MESSAGE:
            raise BagError(f"{self.name}: {what}: {len(content)} bytes are shorter than a message record; damaged bag")
        found = pending if isinstance(pending, Chunk) else Chunk(f"{self.name}: messages outside chunks")
        found.loose.extend(record(opcode, content))
        return found

    def _single(self, source: Source, opcode: int, length: int, what: str) -> Iterator[Chunk | Block]:
        """Yield a record that is not collected with others; the footer is skipped."""
        if opcode == Op.CHUNK and self._recover and source.position + length > (source.size or 0):
            self.losses.append(loss_of_cut_chunk(source, length, what))
            for chunk in beginning_of_chunk(source, read_chunk_head(source, length, what), record_bytes):
                yield replace(chunk, data=whole_records(chunk.data))
        elif opcode == Op.CHUNK:
            source.require(length, what)
            yield from read_chunks(source, read_chunk_head(source, length, what), record_bytes, verify=self._recover)
        elif opcode not in _ENDS:
            summed = 0
            if opcode in (Op.ATTACHMENT, Op.METADATA):
                summed = require_named(opcode, source.sniff(min(length, _NAMES_BYTES)), f"{self.name}: {what}")
            yield from read_pieces(source, opcode, length, what, summed)

    def _records(self, source: Source) -> Iterator[tuple[int, int, str]]:
        """Yield opcode, length and name of the data section's records, whose contents are read by the caller."""
        opcode, length, what, last = 0, 0, "", source.position
        try:
            while opcode not in _ENDS:
                what = f"record at byte {source.position}"
                if self._recover and not (stands_behind(source, last) if opcode == Op.CHUNK else stands_here(source)):
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
        if opcode == Op.DATA_END:
            self._check_data_crc(source, content, crc, f"{self.name}: {what}")
            source.crc, source.summing = 0, True
        try:
            while opcode != Op.FOOTER:
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
                if (opcode, length) == (Op.FOOTER, FOOTER_BYTES) and int.from_bytes(content[:8], "little") == end:
                    require_summary_crc(content, crc, self.name)
                self.summary.keep(opcode, content, self.name, private)
                self.stated = self.summary.message_count
            if source.read(len(MAGIC), "magic at the end") != MAGIC:
                raise BagError(f"{self.name}: does not end as an MCAP does; the bag is damaged")  # noqa: TRY301
            source.require_end()
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
            if len(content) < 4:
                said = f"a DataEnd record of {len(content)} bytes is shorter than its checksum; damaged bag"
                raise BagError(f"{what}: {said}")  # noqa: TRY301
            stated = int.from_bytes(content[:4], "little")
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

    def _block(self, data: NDArray[np.uint8], part: Chunk, *, salvage: bool = False) -> Block:
        contents = read_contents(part, data)
        for opcode, start, end in contents.others:
            if opcode in (Op.SCHEMA, Op.CHANNEL):
                # an unreadable one matters only if messages use it
                with suppress(BagError) if salvage else nullcontext():
                    self._register(opcode, data[start:end].tobytes())
        framing = McapFraming(part.codec, "loose" if part.loose else "chunk")
        return Block(data, contents.table, framing, ends=part.ends)

    _whole_records = staticmethod(whole_records)

    def _read_end(self, source: Source) -> None:  # noqa: ARG002 - the summary was read already
        """Register the channels of the summary; those without a schema there are read from the data section."""
        for schema in self.summary.schemas:
            self._register(Op.SCHEMA, schema)
        for channel in self.summary.channels:
            if ChannelRecord.parse(channel, self.name).schema in (0, *self.schemas):
                self._register(Op.CHANNEL, channel)

    def _read_header(self, source: Source) -> bytes:
        if source.read(len(MAGIC), "magic") != MAGIC:
            raise BagError(f"{self.name}: does not begin as an MCAP does")
        opcode, length = struct.unpack("<BQ", source.read(RECORD_HEADER_BYTES, "header"))
        if opcode != Op.HEADER:
            raise BagError(f"{self.name}: its first record is {opcode:#04x}, not a header; the bag is damaged")
        return source.read(length, "header")


def _add_indexes(chunk: Chunk, source: Source) -> None:
    """Read the message indexes behind a chunk, as far as they are in memory: faster than one by one."""
    ahead, at = source.ahead(), 0
    while ahead[at : at + 1] == _MESSAGE_INDEX:
        content = at + RECORD_HEADER_BYTES
        after = content + int.from_bytes(ahead[at + 1 : content], "little")
        if after > len(ahead):
            break
        chunk.indexes.append((0, ahead[content:after]))
        at = after
    source.read(at, "message indexes")


def _continues(pending: Chunk | Block, opcode: int) -> bool:
    """Return whether a record belongs to the part being collected."""
    if isinstance(pending, Block):
        return False
    if pending.loose:
        return opcode in _LOOSE and len(pending.loose) < BATCH_BYTES
    return opcode == Op.MESSAGE_INDEX

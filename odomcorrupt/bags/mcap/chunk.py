"""Reading of the parts of an MCAP's data section."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Literal, NamedTuple

import numpy as np
from mcap.opcode import Opcode as Op

from odomcorrupt.bags.block import TABLE, Block, Framing
from odomcorrupt.bags.checksum import crc32
from odomcorrupt.bags.chunk import MOST_RECORDS, ChunkHead, gaps_between, windows
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from numpy.typing import NDArray

    from odomcorrupt.bags.chunk import Chunk
    from odomcorrupt.bags.source import Source


RECORD_HEADER_BYTES: Final = 9
MESSAGE_HEADER_BYTES: Final = 31
"""A message record's header and fields: what lies before its data."""


class SchemaRecord(NamedTuple):
    """A message definition."""

    id: int
    name: str
    encoding: str
    data: bytes

    @classmethod
    def parse(cls, content: bytes, what: str) -> SchemaRecord:
        """Return the schema in the content of a record."""
        fields = Fields(content, what)
        return cls(fields.number("H"), fields.string(), fields.string(), fields.blob())

    def pack(self) -> bytes:
        """Return the whole record."""
        head = struct.pack("<H", self.id) + string(self.name) + string(self.encoding)
        return record(Op.SCHEMA, head, struct.pack("<I", len(self.data)), self.data)


class ChannelRecord(NamedTuple):
    """A topic of one publisher; schema 0 is none."""

    id: int
    schema: int
    topic: str
    encoding: str
    metadata: Mapping[str, str]

    @classmethod
    def parse(cls, content: bytes, what: str) -> ChannelRecord:
        """Return the channel in the content of a record."""
        fields = Fields(content, what)
        return cls(fields.number("H"), fields.number("H"), fields.string(), fields.string(), fields.mapping())

    def pack(self) -> bytes:
        """Return the whole record."""
        ids = struct.pack("<HH", self.id, self.schema)
        return record(Op.CHANNEL, ids, string(self.topic), string(self.encoding), mapping(self.metadata))


class Fields:
    """Sequential reader of a record's fields; raises BagError for lengths beyond its end."""

    def __init__(self, content: bytes, what: str) -> None:
        self._content = content
        self._what = what
        self._at = 0

    def number(self, kind: str) -> int:
        """Return the next unsigned integer: B, H, I or Q as struct names them."""
        return int(struct.unpack("<" + kind, self._take(struct.calcsize("<" + kind)))[0])

    def blob(self) -> bytes:
        """Return the next bytes, which a 32-bit length precedes."""
        return self._take(self.number("I"))

    def string(self) -> str:
        """Return the next string."""
        return self.blob().decode(errors="replace")

    def mapping(self) -> dict[str, str]:
        """Return the next map of strings."""
        inner = Fields(self.blob(), self._what)
        found: dict[str, str] = {}
        while inner._at < len(inner._content):
            key = inner.string()
            found[key] = inner.string()
        return found

    def _take(self, size: int) -> bytes:
        begin, self._at = self._at, self._at + size
        if self._at > len(self._content):
            raise BagError(
                f"{self._what}: a field of {size} bytes reaches beyond its record of {len(self._content)}; the bag is "
                "damaged, --recover saves the intact part"
            )
        return self._content[begin : self._at]


def record(opcode: int, *parts: bytes) -> bytes:
    """Return a whole record."""
    return struct.pack("<BQ", opcode, sum(map(len, parts))) + b"".join(parts)


def string(text: str) -> bytes:
    """Return a string with its length before it."""
    data = text.encode()
    return struct.pack("<I", len(data)) + data


def mapping(items: Mapping[str, str]) -> bytes:
    """Return a map of strings with its length before it."""
    data = b"".join(string(key) + string(value) for key, value in items.items())
    return struct.pack("<I", len(data)) + data


def chunk_head(start_ns: int, end_ns: int, *, size: int, crc: int, codec: str, packed: int) -> bytes:
    """Return a chunk record up to its compressed bytes.

    start_ns, end_ns : first and last log time in the chunk
    size, packed : bytes before and after compression
    """
    name = string("" if codec == "none" else codec)
    length = 28 + len(name) + 8 + packed
    return struct.pack("<BQQQQI", Op.CHUNK, length, start_ns, end_ns, size, crc) + name + struct.pack("<Q", packed)


MESSAGE_HEADER = np.dtype(
    [("opcode", "u1"), ("length", "<u8"), ("channel", "<u2"), ("sequence", "<u4"), ("log", "<u8"), ("publish", "<u8")]
)
INDEX_ENTRY = np.dtype([("log", "<u8"), ("offset", "<u8")])


class Record(NamedTuple):
    """A record other than a message, in a chunk; its content is data[start:end]."""

    opcode: int
    start: int
    end: int


class Contents(NamedTuple):
    """Content of a chunk.

    table : (n,) of dtype TABLE, in the order of the data
    others : the other records
    """

    table: NDArray[np.void]
    others: list[Record]


def read_contents(part: Chunk, data: NDArray[np.uint8]) -> Contents:
    """Return the messages and other records of chunks, whose indexes may be missing or wrong if it is a single one.

    data : (size,) the decompressed records
    """
    indexed = _indexed(part, data)
    if indexed is not None:
        return indexed
    if part.ends:
        raise BagError(part.what)  # they are read one by one then
    walked, others = _walk(data.data, 0, data.size, part.what)
    starts = np.array(walked, dtype=np.int64)
    return Contents(_table(_heads(data, starts), starts), others)


def record_bytes(data: memoryview, at: int) -> int:
    """Return the size of the record at an offset, bytes, as `record_blocks` asks for it."""
    if at + RECORD_HEADER_BYTES > len(data):
        return RECORD_HEADER_BYTES
    size = RECORD_HEADER_BYTES + int.from_bytes(data[at + 1 : at + RECORD_HEADER_BYTES], "little")
    return 0 if data[at] == 0 or (data[at] == Op.MESSAGE and size < MESSAGE_HEADER_BYTES) else size


def _indexed(part: Chunk, data: NDArray[np.uint8]) -> Contents | None:
    """Return the content by the indexes, or None where these are incomplete or wrong."""
    starts = part.index_entries(6, INDEX_ENTRY)  # behind its channel and the size of the rest
    if starts is None or not starts.size or starts[0] < 0 or starts[-1] > data.size - MESSAGE_HEADER_BYTES:
        return None
    heads = _heads(data, starts)
    lengths = heads["length"].astype(np.int64)  # as above
    if (heads["opcode"] != Op.MESSAGE).any() or lengths.max() > data.size or lengths.min() < 22:
        return None
    ends = starts + lengths + RECORD_HEADER_BYTES
    gaps = gaps_between(starts, ends, part.ends or (data.size,))
    if gaps is None:
        return None
    others: list[Record] = []
    for begin, end in gaps:
        try:
            messages, records = _walk(data.data, begin, end, "")
        except BagError:
            return None
        if messages:
            return None
        others += records
    return Contents(_table(heads, starts), others)


def _walk(data: memoryview, begin: int, end: int, what: str) -> tuple[list[int], list[Record]]:
    """Parse record by record; return the offsets of messages, and the other records."""
    starts: list[int] = []
    others: list[Record] = []
    at, message = begin, int(Op.MESSAGE)
    while at < end:
        if data[at] == 0 or len(starts) + len(others) >= MOST_RECORDS:
            raise BagError(
                f"{what}: the record at byte {at} of the chunk has opcode 0, or is one of more than {MOST_RECORDS}; "
                "damaged bag, --recover saves the intact part"
            )
        content = at + RECORD_HEADER_BYTES
        after = content + int.from_bytes(data[at + 1 : content], "little")
        if content > end or after > end or (data[at] == message and after < at + MESSAGE_HEADER_BYTES):
            raise BagError(
                f"{what}: the record at byte {at} of the chunk does not fit its {end} bytes; the bag is damaged, "
                "--recover saves the intact part"
            )
        if data[at] == message:
            starts.append(at)
        else:
            others.append(Record(data[at], content, after))
        at = after
    return starts, others


def _heads(data: NDArray[np.uint8], starts: NDArray[np.int64]) -> NDArray[np.void]:
    """Gather the headers of message records, unaligned."""
    return windows(data, MESSAGE_HEADER_BYTES)[starts].view(MESSAGE_HEADER)


def _table(heads: NDArray[np.void], starts: NDArray[np.int64]) -> NDArray[np.void]:
    table = np.empty(starts.size, dtype=TABLE)
    table["channel"] = heads["channel"]
    table["log_ns"] = heads["log"].astype(np.int64)  # a time beyond 2^63 wraps, and wraps back when written
    table["offset"] = starts + MESSAGE_HEADER_BYTES
    table["length"] = heads["length"] - (MESSAGE_HEADER_BYTES - RECORD_HEADER_BYTES)
    return table


_PIECE_BYTES = 1 << 22
CODECS = ("none", "lz4", "zstd")
"""Compressions of chunks, by the names users know: the file calls none an empty string."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class McapFraming(Framing):
    """Framing of a block in its file.

    kind : "chunk"; "loose", messages outside chunks; "record", another record or a piece of a large one
    opcode : of a record, 0 for the later pieces of one
    """

    kind: Literal["chunk", "loose", "record"] = "chunk"
    opcode: int = 0

    def begins(self, table: NDArray[np.void]) -> NDArray[np.int64]:
        """Return the offsets (n,) of the message records, bytes."""
        offsets: NDArray[np.int64] = table["offset"]
        return offsets - MESSAGE_HEADER_BYTES


def read_chunk_head(source: Source, length: int, what: str) -> ChunkHead:
    """Return what a chunk record of `length` bytes has before its compressed bytes, which are read next."""
    named = f"{source.name}: {what}"
    if length < 40:
        raise BagError(f"{named}: a chunk record of {length} bytes is shorter than its fields; damaged bag")
    size, crc, name_length = struct.unpack("<16xQII", source.read(32, what))
    if 40 + name_length > length:
        raise BagError(f"{named}: its compression's name of {name_length} bytes reaches beyond it; damaged bag")
    *text, packed = struct.unpack(f"<{name_length}sQ", source.read(name_length + 8, what))
    name = text[0].decode(errors="replace")
    behind = length - 40 - name_length - packed
    if behind < 0:
        raise BagError(f"{named}: {packed} bytes of records in a record of {length} do not fit; damaged bag")
    codec = name or "none"
    if codec not in CODECS or name == "none":
        raise BagError(f"{named}: compression {name!r} is not known (none, lz4, zstd); recompress the bag")
    return ChunkHead(size, crc, codec, packed, what, behind)


def read_pieces(source: Source, opcode: int, length: int, what: str, summed: int = 0) -> Iterator[Block]:
    """Yield an unparsed record in pieces, since attachments may be larger than memory.

    summed : length of what an attachment's checksum covers, which follows it; 0 for other records

    Raises
    ------
    BagError
        After the last piece, if the checksum is wrong.
    """
    source.require(length, what)
    if summed + 4 > length and summed:
        raise BagError(f"{source.name}: {what}: an attachment of {summed} bytes is longer than its record; damaged bag")
    left, crc, stated = length, 0, b""
    head = struct.pack("<BQ", opcode, length)
    while left or head:
        content = source.read_array(min(left, _PIECE_BYTES), what)
        covered = max(summed - (length - left), 0)
        crc = crc32(content.data[:covered], crc)
        stated += bytes(content.data[covered : covered + 4 - len(stated)])
        left -= content.size
        data = np.concatenate([np.frombuffer(head, dtype=np.uint8), content])
        yield Block(data, np.empty(0, dtype=TABLE), McapFraming("none", "record", opcode if head else 0))
        head = b""
    if summed and int.from_bytes(stated, "little") not in (0, crc):
        raise BagError(f"{source.name}: {what}: the attachment's checksum does not match its bytes; damaged bag")

"""The records of an MCAP file, as its specification lays them out."""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final, NamedTuple

from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Mapping


class Op:
    """Kinds of records."""

    HEADER: Final = 0x01
    FOOTER: Final = 0x02
    SCHEMA: Final = 0x03
    CHANNEL: Final = 0x04
    MESSAGE: Final = 0x05
    CHUNK: Final = 0x06
    MESSAGE_INDEX: Final = 0x07
    CHUNK_INDEX: Final = 0x08
    ATTACHMENT: Final = 0x09
    ATTACHMENT_INDEX: Final = 0x0A
    STATISTICS: Final = 0x0B
    METADATA: Final = 0x0C
    METADATA_INDEX: Final = 0x0D
    SUMMARY_OFFSET: Final = 0x0E
    DATA_END: Final = 0x0F


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

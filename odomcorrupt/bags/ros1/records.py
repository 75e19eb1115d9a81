"""The records of a ROS 1 bag: a header of named fields, and data."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Mapping


class Op:
    """Kinds of records."""

    MESSAGE: Final = 0x02
    BAG_HEADER: Final = 0x03
    INDEX: Final = 0x04
    CHUNK: Final = 0x05
    CHUNK_INFO: Final = 0x06
    CONNECTION: Final = 0x07


_SIZES: Final = {"op": 1, "time": 8, "index_pos": 8}
"""Bytes of the numbers in headers, those that are not 4."""


@dataclass(frozen=True, slots=True)
class Connection:
    """A topic of one publisher.

    topic : as recorded
    fields : connection header: type, md5sum, message_definition, callerid, latching, topic
    header, data : the two parts of the record, unparsed
    """

    id: int
    topic: str
    fields: Mapping[str, bytes]
    header: bytes
    data: bytes

    @classmethod
    def parse(cls, header: bytes, data: bytes, what: str) -> Connection:
        """Return the connection in a record."""
        named = parse_fields(header, what)
        topic = named.get("topic", b"").decode(errors="replace")
        return cls(number(named, "conn", what), topic, parse_fields(data, what), header, data)

    @classmethod
    def build(cls, identifier: int, topic: str, fields: Mapping[str, bytes]) -> Connection:
        """Return a new connection record."""
        header = {"conn": struct.pack("<I", identifier), "op": bytes([Op.CONNECTION]), "topic": topic.encode()}
        return cls(identifier, topic, fields, pack_fields(header), pack_fields(fields))

    @property
    def type(self) -> str:
        """Message type in ROS 1 notation."""
        return self.fields.get("type", b"").decode(errors="replace")

    def pack(self) -> bytes:
        """Return the whole record."""
        return pack_record(self.header, self.data)


def parse_fields(data: bytes, what: str) -> dict[str, bytes]:
    """Return the named fields of a header, each with its length before it."""
    fields: dict[str, bytes] = {}
    at = 0
    while at < len(data):
        begin = at + 4
        at = begin + int.from_bytes(data[at:begin], "little")
        name, equals, value = data[begin:at].partition(b"=")
        if at > len(data) or not equals:
            raise BagError(f"{what}: a header field does not fit its header; the bag is damaged, try --recover")
        fields[name.decode(errors="replace")] = value
    return fields


def number(fields: Mapping[str, bytes], name: str, what: str) -> int:
    """Return an unsigned integer field."""
    value = fields.get(name, b"")
    if len(value) != _SIZES.get(name, 4):
        raise BagError(f"{what}: header field {name!r} is {value!r}, not a number; the bag is damaged, try --recover")
    return int.from_bytes(value, "little")


def pack_fields(fields: Mapping[str, bytes]) -> bytes:
    """Return named fields as a header."""
    return b"".join(
        struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value for name, value in fields.items()
    )


def pack_record(header: bytes, data: bytes) -> bytes:
    """Return a whole record."""
    return struct.pack("<I", len(header)) + header + struct.pack("<I", len(data)) + data

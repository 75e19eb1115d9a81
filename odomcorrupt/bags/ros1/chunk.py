"""Reading of the records and chunks of a ROS 1 bag."""

from __future__ import annotations

import struct
from contextlib import suppress
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from odomcorrupt.bags.block import TABLE, Framing
from odomcorrupt.bags.chunk import MOST_RECORDS, ChunkHead, gaps_between, windows
from odomcorrupt.bags.messages import SECOND_NS
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from odomcorrupt.bags.chunk import Chunk
    from odomcorrupt.bags.source import Source


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


INDEX_ENTRY = np.dtype([("s", "<u4"), ("ns", "<u4"), ("offset", "<u4")])
_TIME = np.dtype([("s", "<u4"), ("ns", "<u4")])


@dataclass(frozen=True, slots=True)
class Contents:
    """Content of a chunk.

    table : (n,) of dtype TABLE, in the order of the data
    starts : (n,) offsets of the message records in the data, bytes
    connections : header and data of the connection records
    """

    table: NDArray[np.void]
    starts: NDArray[np.int64]
    connections: list[tuple[bytes, bytes]]


@dataclass(frozen=True, slots=True)
class _Template:
    """Offsets of the numbers in a message record's header.

    head : (w,) uint8, the header with its length and the numbers zeroed
    mask : (w,) uint8, 0 where numbers lie and 255 elsewhere
    conn, time : their offsets from the record's start
    """

    head: NDArray[np.uint8]
    mask: NDArray[np.uint8]
    conn: int
    time: int


def read_contents(part: Chunk, data: NDArray[np.uint8]) -> Contents:
    """Return the messages and connections of chunks, whose indexes may be missing or wrong if it is a single one.

    data : (size,) the decompressed records
    """
    indexed = _indexed(part, data)
    if part.ends and indexed is None:
        raise BagError(part.what)  # they are read one by one then
    return indexed or _walk(data.data, 0, data.size, part.what)


def record_bytes(data: memoryview, at: int) -> int:
    """Return the size of the record at an offset, bytes, as `record_blocks` asks for it."""
    header = at + 4
    if header > len(data):
        return 4
    end = header + int.from_bytes(data[at:header], "little")
    if end + 4 > len(data):
        return end + 4 - at
    if b"op=" not in bytes(data[header:end]):
        return 0
    return end + 4 + int.from_bytes(data[end : end + 4], "little") - at


def _indexed(part: Chunk, data: NDArray[np.uint8]) -> Contents | None:
    """Return the content by the index, or None where it is incomplete or wrong."""
    starts = part.index_entries(0, INDEX_ENTRY)
    template = _template(data, int(starts[0])) if starts is not None and starts.size else None
    if starts is None or template is None or starts[-1] > data.size - template.head.size - 4:
        return None
    width = template.head.size
    heads = windows(data, width + 4)[starts].view(np.uint8).reshape(-1, width + 4)
    if np.any((heads[:, :width] ^ template.head) & template.mask):
        return None
    table = np.empty(starts.size, dtype=TABLE)
    table["channel"] = _column(heads, template.conn, np.dtype("<u4"))
    times = _column(heads, template.time, _TIME)
    table["log_ns"] = times["s"].astype(np.int64) * SECOND_NS + times["ns"]
    table["offset"] = starts + width + 4
    table["length"] = _column(heads, width, np.dtype("<u4"))
    connections = _between(data, gaps_between(starts, table["offset"] + table["length"], part.ends or (data.size,)))
    return None if connections is None else Contents(table, starts, connections)


def _between(data: NDArray[np.uint8], gaps: list[tuple[int, int]] | None) -> list[tuple[bytes, bytes]] | None:
    """Return the connection records between indexed messages; None where there is anything else."""
    connections: list[tuple[bytes, bytes]] = []
    try:
        for begin, end in gaps or []:
            found = _walk(data.data, begin, end, "")
            if found.table.size:
                return None
            connections += found.connections
    except BagError:
        return None
    return None if gaps is None else connections


def _template(data: NDArray[np.uint8], start: int) -> _Template | None:
    """Return the header layout of the message record at an offset; None where there is none."""
    length = int.from_bytes(data[start : start + 4].tobytes(), "little")
    head = data[start : start + 4 + length].copy()
    if length > 4096 or head.size < 4 + length:
        return None
    raw = head.tobytes()
    conn, time, op = raw.find(b"\x09\0\0\0conn="), raw.find(b"\x0d\0\0\0time="), raw.find(b"\x04\0\0\0op=\x02")
    if min(conn, time, op) < 0:
        return None
    mask = np.full(head.size, 255, dtype=np.uint8)
    mask[conn + 9 : conn + 13] = 0
    mask[time + 9 : time + 17] = 0
    with suppress(BagError):
        if sum(len(name) + 5 + len(value) for name, value in parse_fields(raw[4:], "").items()) == length:
            return _Template(head & mask, mask, conn + 9, time + 9)
    return None


def _column(heads: NDArray[np.uint8], offset: int, kind: np.dtype[Any]) -> NDArray[Any]:
    return np.ascontiguousarray(heads[:, offset : offset + kind.itemsize]).view(kind)[:, 0]


def _walk(data: memoryview, begin: int, end: int, what: str) -> Contents:
    """Parse record by record."""
    rows: list[tuple[int, int, int, int]] = []
    starts: list[int] = []
    connections: list[tuple[bytes, bytes]] = []
    at = begin
    count = 0
    while at < end:
        count += 1
        if count > MOST_RECORDS:
            raise BagError(f"{what}: has more than {MOST_RECORDS} records; the bag is damaged")
        header_end = at + 4 + int.from_bytes(data[at : at + 4], "little")
        after = header_end + 4 + int.from_bytes(data[header_end : header_end + 4], "little")
        if header_end + 4 > end or after > end:
            raise BagError(
                f"{what}: the record at byte {at} of the chunk does not fit its {end} bytes; the bag is damaged, "
                "--recover saves the intact part"
            )
        header = bytes(data[at + 4 : header_end])
        fields = parse_fields(header, what)
        op = number(fields, "op", what)
        if op == Op.MESSAGE:
            time = number(fields, "time", what)
            log_ns = (time & 0xFFFFFFFF) * SECOND_NS + (time >> 32)
            rows.append((number(fields, "conn", what), log_ns, header_end + 4, after - header_end - 4))
            starts.append(at)
        elif op == Op.CONNECTION:
            connections.append((header, bytes(data[header_end + 4 : after])))
        at = after
    return Contents(np.array(rows, dtype=TABLE), np.array(starts, dtype=np.int64), connections)


CODECS = ("none", "lz4", "bz2")
_HEADER_LIMIT = 1 << 24


@dataclass(frozen=True, slots=True)
class Ros1Framing(Framing):
    """Framing of a block in its bag.

    starts : (n,) offsets of the message records in the block's data, bytes
    """

    starts: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))

    def begins(self, table: NDArray[np.void]) -> NDArray[np.int64]:  # noqa: ARG002 - headers differ in length
        """Return the offsets (n,) of the message records, bytes."""
        return self.starts

    def kept(self, begins: NDArray[np.int64]) -> Ros1Framing:
        """Return the framing of some of the messages."""
        return Ros1Framing(self.codec, begins)

    def joined(self, behind: list[Ros1Framing], begins: list[int]) -> Ros1Framing:
        """Return the framing of this chunk joined with those after it."""
        moved = [one.starts + begin for one, begin in zip(behind, begins, strict=True)]
        return Ros1Framing(self.codec, np.concatenate([self.starts, *moved]))


class Head(NamedTuple):
    """Header of a record; the caller reads its data."""

    op: int
    header: bytes
    fields: dict[str, bytes]
    size: int
    what: str


def read_head(source: Source, *, whole: bool = True) -> Head:
    """Return a record's header; its data must be complete if `whole`."""
    what = f"record at byte {source.position}"
    named = f"{source.name}: {what}"
    length = int.from_bytes(source.read(4, what), "little")
    if length > _HEADER_LIMIT:
        raise BagError(f"{named} claims a header of {length} bytes; the bag is damaged, try --recover")
    header = source.read(length, what)
    fields = parse_fields(header, named)
    size = int.from_bytes(source.read(4, what), "little")
    if whole:
        source.require(size, what)
    return Head(number(fields, "op", named), header, fields, size, what)


def chunk_head(source: Source, head: Head) -> ChunkHead:
    """Return what the header of a chunk record says; a ROS 1 bag has no checksums."""
    named = f"{source.name}: {head.what}"
    codec = head.fields.get("compression", b"").decode(errors="replace")
    if codec not in CODECS:
        raise BagError(f"{named}: compression {codec!r} is not known (none, lz4, bz2); recompress the bag")
    return ChunkHead(number(head.fields, "size", named), 0, codec, head.size, head.what)

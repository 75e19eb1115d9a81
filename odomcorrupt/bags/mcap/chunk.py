"""Reading of the parts of an MCAP's data section."""

from __future__ import annotations

import struct
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from odomcorrupt.bags.block import TABLE, Block, Framing
from odomcorrupt.bags.checksum import crc32
from odomcorrupt.bags.codec_streams import PackedInSource, unpacked
from odomcorrupt.bags.codecs import decompress
from odomcorrupt.bags.mcap.chunk_messages import record_bytes
from odomcorrupt.bags.mcap.records import MESSAGE
from odomcorrupt.bags.record_blocks import LARGE_BYTES, record_blocks
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from odomcorrupt.bags.budget import Budget
    from odomcorrupt.bags.source import Source

__all__ = ["CODECS", "Chunk", "Loose", "McapFraming", "chunks_of", "read_chunk_head", "read_chunks", "read_pieces"]

_PIECE_BYTES = 1 << 22
CODECS = ("none", "lz4", "zstd")
"""Compressions of chunks, by the names users know: the file calls none an empty string."""


@dataclass(frozen=True, slots=True)
class McapFraming(Framing):
    """Framing of a block in its file.

    kind : "chunk"; "loose", messages outside chunks; "record", another record or a piece of a large one
    codec : of a chunk
    opcode : of a record, 0 for the later pieces of one
    """

    kind: Literal["chunk", "loose", "record"]
    codec: str = "none"
    opcode: int = 0

    def goes_on_with(self, other: object) -> bool:
        """Return whether both are chunks of one compression."""
        return self.kind == "chunk" and self == other


@dataclass(frozen=True, slots=True)
class Chunk:
    """A decompressed chunk or a part of one, and the contents of the message indexes that follow it."""

    data: NDArray[np.uint8]
    codec: str
    what: str
    indexes: list[bytes] = field(default_factory=list)

    def append(self, _opcode: int, content: bytes, _what: str) -> None:
        """Append a message index."""
        self.indexes.append(content)


class Loose:
    """Messages, schemas and channels outside chunks, collected for a block."""

    def __init__(self) -> None:
        self.data = bytearray()
        self.others: list[tuple[int, bytes]] = []
        self._rows: list[tuple[int, int, int, int]] = []

    def append(self, opcode: int, content: bytes, what: str) -> None:
        """Append a record."""
        self.data += struct.pack("<BQ", opcode, len(content))
        if opcode != MESSAGE:
            self.others.append((opcode, content))
        elif len(content) < 22:
            raise BagError(f"{what}: a message record of {len(content)} bytes is shorter than its fields; damaged bag")
        else:
            channel, log_ns = struct.unpack_from("<H4xq", content)
            self._rows.append((channel, log_ns, len(self.data) + 22, len(content) - 22))
        self.data += content

    def block(self) -> Block:
        """Return the collected records as a block."""
        return Block(np.frombuffer(self.data, np.uint8), np.array(self._rows, dtype=TABLE), McapFraming("loose"))


class ChunkHead(NamedTuple):
    """Fields of a chunk record before its compressed bytes.

    size, crc : of the decompressed bytes; no checksum is 0
    packed : number of compressed bytes
    behind : number of bytes after them, fields of later versions of the format
    what : name of the chunk in error messages
    """

    size: int
    crc: int
    codec: str
    packed: int
    behind: int
    what: str

    def require_crc(self, actual: int) -> None:
        """Raise BagError if the checksum of the decompressed bytes is another one."""
        if self.crc not in (0, actual):
            raise BagError(f"{self.what}: its checksum does not match its bytes; --recover saves what is whole")


def read_chunk_head(source: Source, length: int, what: str) -> ChunkHead:
    """Read a chunk record's content of `length` bytes up to its compressed bytes."""
    named = f"{source.name}: {what}"
    if length < 40:
        raise BagError(f"{named}: a chunk record of {length} bytes is shorter than its fields; damaged bag")
    size, crc, name_length = struct.unpack("<16xQII", source.read(32, what))
    if 40 + name_length > length:
        raise BagError(f"{named}: its compression's name of {name_length} bytes reaches beyond it; damaged bag")
    name = source.read(name_length, what).decode(errors="replace")
    (packed,) = struct.unpack("<Q", source.read(8, what))
    behind = length - 40 - name_length - packed
    if behind < 0:
        raise BagError(f"{named}: {packed} bytes of records in a record of {length} do not fit; damaged bag")
    codec = name or "none"
    if codec not in CODECS or name == "none":
        raise BagError(f"{named}: compression {name!r} is not known (none, lz4, zstd); recompress the bag")
    return ChunkHead(size, crc, codec, packed, behind, named)


def read_chunks(source: Source, length: int, what: str, *, verify: bool) -> Iterator[Chunk]:
    """Yield a chunk record's content decompressed: whole, or a large one as several of whole records.

    verify : whether a large chunk is read twice, so that nothing of a damaged one is yielded
    """
    source.require(length, what)
    head = read_chunk_head(source, length, what)
    if head.codec == "none" and head.size != head.packed:
        raise BagError(f"{head.what}: says it holds {head.size} bytes, but has {head.packed}; damaged bag")
    if head.size <= LARGE_BYTES:
        yield _read_whole(source, head, what)
        return
    budget: Budget | None = source.budget
    if verify and (head.crc or head.codec != "none"):
        here = source.position
        for _ in _pieces(source, head, what, budget):
            pass
        source.seek(here)
        budget = None
    yield from chunks_of(_pieces(source, head, what, budget), head, source)


def chunks_of(pieces: Iterator[bytes | memoryview], head: ChunkHead, source: Source) -> Iterator[Chunk]:
    """Yield the decompressed pieces of a chunk as chunks of whole records."""
    begin = 0
    for data in record_blocks(pieces, head.size, record_bytes, source.shelf.place, head.what):
        yield Chunk(data, head.codec, f"{head.what}, from byte {begin} of its records" if begin else head.what)
        begin += data.size


def _read_whole(source: Source, head: ChunkHead, what: str) -> Chunk:
    if head.codec == "none":
        data, actual = source.read_summed(head.packed, what)
    else:
        packed = source.read_scratch(head.packed, what)
        data = decompress(head.codec, packed, head.size, head.what, source.shelf, source.budget)
        actual = crc32(data.data) if head.crc else 0
    source.read(head.behind, what)
    head.require_crc(actual)
    return Chunk(data, head.codec, head.what)


def _pieces(source: Source, head: ChunkHead, what: str, budget: Budget | None) -> Iterator[bytes | memoryview]:
    """Yield the decompressed pieces of a chunk, and read its record to the end."""
    packed, crc = PackedInSource(source, head.packed, what), 0
    for piece in unpacked(head.codec, packed, head.size, head.what, budget):
        crc = crc32(piece, crc) if head.crc else 0
        yield piece
    packed.skip()
    source.read(head.behind, what)
    head.require_crc(crc)


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
        yield Block(data, np.empty(0, dtype=TABLE), McapFraming("record", opcode=opcode if head else 0))
        head = b""
    if summed and int.from_bytes(stated, "little") not in (0, crc):
        raise BagError(f"{source.name}: {what}: the attachment's checksum does not match its bytes; damaged bag")

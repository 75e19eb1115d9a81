"""Reading of the parts of an MCAP's data section."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from odomcorrupt.bags.block import TABLE, Block, Framing
from odomcorrupt.bags.checksum import crc32
from odomcorrupt.bags.chunk import ChunkHead
from odomcorrupt.bags.mcap.records import MESSAGE, MESSAGE_HEADER_BYTES
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from odomcorrupt.bags.source import Source

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

    def begins(self, table: NDArray[np.void]) -> NDArray[np.int64]:
        """Return the offsets (n,) of the message records, bytes."""
        offsets: NDArray[np.int64] = table["offset"]
        return offsets - MESSAGE_HEADER_BYTES

    def goes_on_with(self, other: object) -> bool:
        """Return whether both are chunks of one compression."""
        return self.kind == "chunk" and self == other


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


def read_chunk_head(source: Source, length: int, what: str) -> ChunkHead:
    """Return what a chunk record of `length` bytes has before its compressed bytes, which are read next."""
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
        yield Block(data, np.empty(0, dtype=TABLE), McapFraming("record", opcode=opcode if head else 0))
        head = b""
    if summed and int.from_bytes(stated, "little") not in (0, crc):
        raise BagError(f"{source.name}: {what}: the attachment's checksum does not match its bytes; damaged bag")

"""Reading of the records and chunks of a ROS 1 bag."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.block import Framing
from odomcorrupt.bags.chunk import ChunkHead
from odomcorrupt.bags.ros1.records import number, parse_fields
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.bags.source import Source

CODECS = ("none", "lz4", "bz2")
_HEADER_LIMIT = 1 << 24


@dataclass(frozen=True, slots=True)
class Ros1Framing(Framing):
    """Framing of a block in its bag.

    codec : of the chunk
    starts : (n,) offsets of the message records in the block's data, bytes
    """

    codec: str
    starts: NDArray[np.int64]

    def begins(self, table: NDArray[np.void]) -> NDArray[np.int64]:  # noqa: ARG002 - headers differ in length
        """Return the offsets (n,) of the message records, bytes."""
        return self.starts

    def kept(self, begins: NDArray[np.int64]) -> Ros1Framing:
        """Return the framing of some of the messages."""
        return Ros1Framing(self.codec, begins)

    def goes_on_with(self, other: object) -> bool:
        """Return whether both are chunks of one compression."""
        return isinstance(other, Ros1Framing) and self.codec == other.codec

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

"""Reading of the records and chunks of a ROS 1 bag."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.block import Framing
from odomcorrupt.bags.codec_streams import PackedInSource, unpacked
from odomcorrupt.bags.codecs import decompress
from odomcorrupt.bags.record_blocks import LARGE_BYTES, record_blocks
from odomcorrupt.bags.ros1.chunk_messages import record_bytes
from odomcorrupt.bags.ros1.records import number, parse_fields
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from odomcorrupt.bags.budget import Budget
    from odomcorrupt.bags.source import Source

__all__ = ["CODECS", "Chunk", "Head", "Ros1Framing", "chunks_of", "codec_and_size", "read_chunks", "read_head"]

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

    def goes_on_with(self, other: object) -> bool:
        """Return whether both are chunks of one compression."""
        return isinstance(other, Ros1Framing) and self.codec == other.codec

    def joined(self, behind: list[Ros1Framing], begins: list[int]) -> Ros1Framing:
        """Return the framing of this chunk joined with those after it."""
        moved = [one.starts + begin for one, begin in zip(behind, begins, strict=True)]
        return Ros1Framing(self.codec, np.concatenate([self.starts, *moved]))


@dataclass(frozen=True, slots=True)
class Chunk:
    """A decompressed chunk or a part of one, and the index records that follow it.

    open : records of a chunk that was never finished
    """

    data: NDArray[np.uint8]
    codec: str
    what: str
    indexes: list[bytes] = field(default_factory=list)
    open: bytearray = field(default_factory=bytearray)


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


def read_chunks(source: Source, head: Head, *, verify: bool) -> Iterator[Chunk]:
    """Yield a chunk record's data decompressed: whole, or a large one as several of whole records.

    verify : whether a large chunk is read twice, so that nothing of a damaged one is yielded
    """
    named = f"{source.name}: {head.what}"
    codec, size = codec_and_size(head, named)
    if codec == "none" and size != head.size:
        raise BagError(f"{named}: says it holds {size} bytes, but has {head.size}; the bag is damaged")
    if size <= LARGE_BYTES:
        if codec == "none":
            data = source.read_array(head.size, head.what)
        else:
            packed = source.read_scratch(head.size, head.what)
            data = decompress(codec, packed, size, named, source.shelf, source.budget)
        yield Chunk(data, codec, named)
        return
    budget: Budget | None = source.budget
    if verify and codec != "none":
        here = source.position
        for _ in _pieces(source, head, named, budget):
            pass
        source.seek(here)
        budget = None
    yield from chunks_of(_pieces(source, head, named, budget), head, source)


def chunks_of(pieces: Iterator[bytes | memoryview], head: Head, source: Source) -> Iterator[Chunk]:
    """Yield the decompressed pieces of a chunk as chunks of whole records."""
    named, begin = f"{source.name}: {head.what}", 0
    codec, size = codec_and_size(head, named)
    for data in record_blocks(pieces, size, record_bytes, source.shelf.place, named):
        yield Chunk(data, codec, f"{named}, from byte {begin} of its records" if begin else named)
        begin += data.size


def codec_and_size(head: Head, named: str) -> tuple[str, int]:
    """Return the compression of a chunk and its decompressed size, bytes, by its header."""
    codec = head.fields.get("compression", b"").decode(errors="replace")
    if codec not in CODECS:
        raise BagError(f"{named}: compression {codec!r} is not known (none, lz4, bz2); recompress the bag")
    return codec, number(head.fields, "size", named)


def _pieces(source: Source, head: Head, named: str, budget: Budget | None) -> Iterator[bytes | memoryview]:
    """Yield the decompressed pieces of a chunk, and read its record to the end."""
    codec, size = codec_and_size(head, named)
    packed = PackedInSource(source, head.size, head.what)
    yield from unpacked(codec, packed, size, named, budget)
    packed.skip()

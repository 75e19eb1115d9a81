"""Chunks, read whole, or a large one as several of whole records: its size does not decide on the memory."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.checksum import crc32
from odomcorrupt.bags.codecs import Packed, beginning, decompress, unpacked
from odomcorrupt.bags.source import LARGEST_BYTES, extended, lies_behind
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from odomcorrupt.bags.source import Budget, Source

    RecordBytes = Callable[[memoryview, int], int]


def gaps_between(
    starts: NDArray[np.int64], ends: NDArray[np.int64], chunk_ends: tuple[int, ...]
) -> list[tuple[int, int]] | None:
    """Return the spans of chunks without records (n,), sorted by start; None if some overlap or lie in two chunks.

    If the gaps consist of whole records, none of the indexed kind, the index is correct and complete.
    """
    *inner, size = chunk_ends
    if inner:  # as records without a length
        at = np.searchsorted(starts, inner)
        starts, ends = np.insert(starts, at, inner), np.insert(ends, at, inner)
    befores, afters = np.concatenate(([0], ends)), np.concatenate((starts, [size]))
    (open_ones,) = (befores != afters).nonzero()
    if not open_ones.size:
        return []
    befores, afters = befores[open_ones], afters[open_ones]
    if (befores > afters).any():
        return None
    return list(zip(befores.tolist(), afters.tolist(), strict=True))


def windows(data: NDArray[np.uint8], width: int) -> NDArray[np.void]:
    """Return a view of data as overlapping windows, one per byte, to index whole unaligned fields."""
    if data.size < width:
        return np.empty(0, dtype=f"V{width}")
    return np.ndarray((data.size - width + 1,), dtype=f"V{width}", buffer=data, strides=(1,))


LARGE_BYTES = 32 << 20
"""Decompressed size of a chunk beyond which it is read as several: recorders write 0.8 to 4 MB."""

_BLOCK_BYTES = 4 << 20
"""What is read of a large chunk at once, if no record is larger; the writers make a chunk of it."""

MOST_RECORDS = 1 << 22
"""What a chunk without an index of its messages is walked for: no recorder writes a tenth of it."""

BATCH_BYTES = 1 << 20
"""What of messages outside of chunks, or of rows, becomes a block."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Chunk:
    """A decompressed chunk or a part of one, or several in one buffer, and the contents of the indexes behind each.

    indexes : offset in data of the chunk that it belongs to, and its content
    loose : in place of data, collected records that stand outside of chunks
    places : position of each chunk's data in the file, and their stated CRC-32; empty if they are compressed
    ends : end offsets of several chunks; empty for a single one
    """

    what: str
    codec: str = "none"
    data: NDArray[np.uint8] = field(default_factory=lambda: np.empty(0, dtype=np.uint8))
    indexes: list[tuple[int, bytes]] = field(default_factory=list)
    loose: bytearray = field(default_factory=bytearray)
    places: tuple[tuple[int, int], ...] = ()
    ends: tuple[int, ...] = ()

    @property
    def records(self) -> NDArray[np.uint8]:
        """Its records (size,), bytes."""
        return np.frombuffer(self.loose, dtype=np.uint8) if self.loose else self.data

    @classmethod
    def joined(cls, run: list[Chunk]) -> Chunk:
        """Return chunks that lie side by side as one."""
        if len(run) == 1:
            return run[0]
        begins = [0, *(ends := np.cumsum([one.data.size for one in run]).tolist())]
        indexes = [(begin, index) for one, begin in zip(run, begins, strict=False) for _, index in one.indexes]
        places = tuple(place for one in run for place in one.places)
        first = run[0]
        data = extended(first.data, ends[-1])
        return cls(first.what, first.codec, data, indexes, places=places, ends=tuple(ends))

    def goes_on_with(self, other: Chunk) -> bool:
        """Return whether another chunk lies directly behind this one in memory, and is stored in the same way."""
        alike = self.codec == other.codec and len(self.places) == len(other.places)
        return alike and not (self.loose or other.loose) and lies_behind(other.data, self.data)

    def index_entries(self, skipped: int, kind: np.dtype[np.void]) -> NDArray[np.int64] | None:
        """Return the sorted offsets of messages (n,) by the indexes; None if one is not a whole number of entries.

        skipped : bytes of an index before its entries
        kind : of an entry, with its `offset` in the chunk
        """
        if any((len(index) - skipped) % kind.itemsize for _, index in self.indexes):
            return None
        entries = np.frombuffer(b"".join([index[skipped:] for _, index in self.indexes]), dtype=kind)
        starts = entries["offset"].astype(np.int64)  # beyond 2^63 they are negative
        if self.ends:
            counts = [(len(index) - skipped) // kind.itemsize for _, index in self.indexes]
            starts += np.repeat(np.array([begin for begin, _ in self.indexes], dtype=np.int64), counts)
        starts.sort()
        return starts


class ChunkHead(NamedTuple):
    """What a chunk record says before its compressed bytes.

    size, crc : of the decompressed bytes; no checksum is 0
    packed : number of compressed bytes
    what : name of the record
    behind : number of bytes after the compressed ones, fields of later versions of the format
    """

    size: int
    crc: int
    codec: str
    packed: int
    what: str
    behind: int = 0


def read_chunks(source: Source, head: ChunkHead, record_bytes: RecordBytes, *, verify: bool) -> Iterator[Chunk]:
    """Yield a chunk record's content decompressed: whole, or a large one as several of whole records.

    verify : whether a large chunk is read twice, so that nothing of a damaged one is yielded
    """
    named = f"{source.name}: {head.what}"
    if head.codec == "none" and head.size != head.packed:
        raise BagError(f"{named}: states {head.size} bytes, but has {head.packed}; the bag is damaged")
    if head.size <= LARGE_BYTES:
        places = ((source.position, head.crc),) if head.codec == "none" else ()
        yield Chunk(named, head.codec, _read_whole(source, head, named), places=places)
        return
    budget: Budget | None = source.budget
    if verify and (head.crc or head.codec != "none"):
        here = source.position
        for _ in _pieces(source, head, named, budget):
            pass
        source.seek(here)
        budget = None
    yield from _chunks_of(_pieces(source, head, named, budget), head, source, record_bytes)


def beginning_of_chunk(source: Source, head: ChunkHead, record_bytes: RecordBytes) -> Iterator[Chunk]:
    """Yield what the file has of a chunk that is truncated by its end, as far as it decompresses."""
    packed = Packed(source, (source.size or 0) - source.position, head.what)
    yield from _chunks_of(beginning(head.codec, packed, source.budget), head, source, record_bytes)


def _chunks_of(
    pieces: Iterator[bytes | memoryview], head: ChunkHead, source: Source, record_bytes: RecordBytes
) -> Iterator[Chunk]:
    """Yield the decompressed pieces of a chunk as chunks of whole records."""
    named, begin = f"{source.name}: {head.what}", 0
    for data in record_blocks(pieces, head.size, record_bytes, source.pool.place, named):
        yield Chunk(f"{named}, from byte {begin} of its records" if begin else named, head.codec, data)
        begin += data.size


def _read_whole(source: Source, head: ChunkHead, named: str) -> NDArray[np.uint8]:
    actual = 0
    if head.codec != "none":
        packed = source.read_scratch(head.packed, head.what)
        data = decompress(head.codec, packed, head.size, named, source.pool, source.budget)
        actual = crc32(data.data) if head.crc else 0
    else:
        data = source.read_array(head.packed, head.what)
        actual = source.crc_of_last if source.summing else crc32(data.data) if head.crc else 0
    source.read(head.behind, head.what)
    _require_crc(head, actual, named)
    return data


def _pieces(source: Source, head: ChunkHead, named: str, budget: Budget | None) -> Iterator[bytes | memoryview]:
    """Yield the decompressed pieces of a chunk, and read its record to the end."""
    packed, crc = Packed(source, head.packed, head.what), 0
    for piece in unpacked(head.codec, packed, head.size, named, budget):
        crc = crc32(piece, crc) if head.crc else 0
        yield piece
    packed.skip()
    source.read(head.behind, head.what)
    _require_crc(head, crc, named)


def _require_crc(head: ChunkHead, actual: int, named: str) -> None:
    """Raise BagError if a chunk states a checksum that is not that of its decompressed bytes."""
    if head.crc not in (0, actual):
        raise BagError(f"{named}: its checksum does not match its bytes; --recover saves the intact part")


def record_blocks(
    pieces: Iterator[bytes | memoryview], size: int, record_bytes: RecordBytes,
    place: Callable[[int], NDArray[np.uint8]], what: str,
) -> Iterator[NDArray[np.uint8]]:  # fmt: skip
    """Yield the records of a chunk in blocks of about 4 MB, or of one record that is larger.

    The blocks do not depend on how the stream is divided into pieces. The last one ends in the middle of a record if
    the chunk does; if a record cannot be one, or is larger than what is left of the chunk, that block is the last and
    is yielded when the stream has come to its end, where its checksum is compared.

    pieces : the decompressed chunk, none of them empty
    size : its stated size, bytes
    record_bytes : size of the record that begins at an offset of the data, bytes; less if its header is not whole, but
        more than the data has; 0 if it is no record
    place : allocator of buffers
    what : name of the chunk in error messages

    Raises
    ------
    BagError
        If there is no memory for one of its records.
    """
    piece, rest, wanted, behind = memoryview(b""), np.empty(0, dtype=np.uint8), _BLOCK_BYTES, 0
    while True:
        try:
            buffer = place(wanted)
        except MemoryError as error:
            raise BagError(f"{what}: not enough memory for a record of {wanted} bytes") from error
        filled = rest.size
        buffer[:filled] = rest
        while filled < wanted and (piece or (piece := memoryview(next(pieces, b"")))):
            taken = min(len(piece), wanted - filled)
            buffer.data[filled : filled + taken] = piece[:taken]
            piece, filled = piece[taken:], filled + taken
        end, needed = _last_end(buffer.data[:filled], record_bytes)
        if end:
            yield buffer[:end]
        rest, behind = buffer[end:filled], behind + end
        whole = filled < wanted
        if not whole and rest.size and not 0 < needed <= min(size - behind, LARGEST_BYTES):
            for _ in pieces:
                pass
            whole = True
        if whole:
            if rest.size:
                yield rest
            return
        wanted = max(_BLOCK_BYTES, needed)


def _last_end(data: memoryview, record_bytes: RecordBytes) -> tuple[int, int]:
    """Return where the last whole record ends, and the size of the one that begins there."""
    at, needed = 0, 0
    while at < len(data):
        needed = record_bytes(data, at)
        if not 0 < needed <= len(data) - at:
            break
        at, needed = at + needed, 0
    return at, needed

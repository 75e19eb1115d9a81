"""Compression and decompression of chunks, whole or as streams: none, bz2, zstd, lz4, and the LZ4 frames of ROS 1."""

from __future__ import annotations

import bz2
import threading
from contextlib import suppress
from io import BytesIO
from typing import TYPE_CHECKING

import lz4.frame
import numpy as np
import xxhash
import zstandard

from odomcorrupt.bags.source import ARENA_BYTES, Budget, Source
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from odomcorrupt.bags.source import BufferPool


_PIECE_BYTES = 1 << 20
_SKIPPABLE_MAGIC = 0x184D2A50
_RUN_LENGTH_BLOCK = 1
"""In a Zstandard frame: one byte that stands for as many as the block's size says."""
_CHECKSUM_FLAG = 0x04
_SHORTEST_HEAD = 5
"""Of a Zstandard frame: its magic number, and the byte that tells how long the head is."""

DAMAGE = (zstandard.ZstdError, RuntimeError, OSError, EOFError, ValueError, MemoryError, OverflowError)
"""What the codecs raise on bytes that are not theirs, or on a size no machine has."""


class Packed:
    """Compressed bytes that are next in a file or pipe.

    source : where they are read from
    size : how many there are
    what : name of the chunk in error messages
    left : bytes not yet read
    """

    def __init__(self, source: Source, size: int, what: str) -> None:
        self._source, self.left, self._what = source, size, what

    def read(self, size: int) -> memoryview:
        """Return the next bytes, fewer at the end; valid until the source is read again."""
        piece = self._source.read_scratch(min(size, self.left), self._what)
        self.left -= len(piece)
        return piece

    def skip(self) -> None:
        """Read the rest for its checksum only."""
        self._source.skim(self.left, self._what)
        self.left = 0


def unpacked(codec: str, packed: Packed, size: int, what: str, budget: Budget | None) -> Iterator[bytes | memoryview]:
    """Yield a chunk in decompressed pieces, none of them empty and each valid until the next.

    codec : "none", "lz4", "zstd" or "bz2"
    packed : compressed bytes
    size : decompressed size stated by the bag, bytes
    what : name of the chunk in error messages
    budget : limit of the bag; None if the chunk was counted before

    Raises
    ------
    BagError
        If the chunk is damaged, is not of that size, or exceeds the budget.
    """
    if codec == "none":
        budget = None
    if budget is not None:
        budget.require(size, packed.left, what)
    return _counted(codec, packed, size, what, budget)


def _counted(codec: str, packed: Packed, size: int, what: str, budget: Budget | None) -> Iterator[bytes | memoryview]:
    came = 0
    try:
        for piece in _PIECES[codec](packed):
            came += len(piece)
            if budget is not None:
                budget.take(len(piece), what)
            if came > size:
                break
            if piece:
                yield piece
    except BagError:
        raise
    except DAMAGE as error:
        raise BagError(f"{what}: {codec} cannot decompress it: {error}; --recover saves the intact part") from error
    require_size(came, size, what)


def require_size(came: int, size: int, what: str) -> None:
    """Raise BagError if not as many bytes came out of a chunk as it states."""
    if came != size:
        raise BagError(f"{what}: states {size} bytes, but unpacks to {came}; --recover saves the intact part")


def beginning(codec: str, packed: Packed, budget: Budget) -> Iterator[bytes | memoryview]:
    """Yield the decompressed beginning of a truncated chunk in pieces, within the budget."""
    counted = codec != "none"
    if counted:
        budget.require(0, packed.left, "")
    with suppress(*DAMAGE):
        for piece in _PIECES[codec](packed):
            if counted:
                if len(piece) >= budget.left:
                    break
                budget.take(len(piece), "")
            if piece:
                yield piece


def zstd_pieces(packed: Packed) -> Iterator[bytes]:
    """Decompress frames block by block (RFC 8878, section 3.1): each becomes 128 kB at most, and a cut is seen."""
    decompressor = zstandard.ZstdDecompressor()
    begun = False
    while packed.left or not begun:
        head, begun = _exactly(packed, _SHORTEST_HEAD), True
        if int.from_bytes(head[:4], "little") & ~0xF == _SKIPPABLE_MAGIC:
            size = int.from_bytes(head[4:] + _exactly(packed, 3), "little")
            while size:
                size -= len(_exactly(packed, min(size, _PIECE_BYTES)))
            continue
        frame = decompressor.decompressobj()
        frame.decompress(head + _exactly(packed, zstandard.frame_header_size(head) - len(head)))
        last = 0
        while not last:
            block = _exactly(packed, 3)
            last, size = _block(block)
            content = packed.read(size)
            yield frame.decompress(b"".join((block, content)))
            if len(content) < size:
                raise EOFError("a frame is cut short")
        if head[4] & _CHECKSUM_FLAG:
            frame.decompress(_exactly(packed, 4))


def _block(head: bytes | memoryview) -> tuple[int, int]:
    """Return whether a block of a Zstandard frame is the last, and its compressed size, bytes, by its head."""
    number = int.from_bytes(head, "little")
    return number & 1, 1 if number >> 1 & 3 == _RUN_LENGTH_BLOCK else number >> 3


def _exactly(packed: Packed, size: int) -> bytes:
    found = bytes(packed.read(size))
    if len(found) < size:
        raise EOFError("a frame is cut short")
    return found


def _of_lz4(packed: Packed) -> Iterator[bytes]:
    context, ends = lz4.frame.create_decompression_context(), False
    compressed = memoryview(b"")
    while not ends:
        compressed = compressed or packed.read(_PIECE_BYTES)
        piece, taken, ends = lz4.frame.decompress_chunk(context, compressed, max_length=_PIECE_BYTES)
        if not (piece or taken or ends):
            raise EOFError("the frame is cut short")
        compressed = compressed[taken:]
        yield piece


def _of_bz2(packed: Packed) -> Iterator[bytes]:
    decompressor = bz2.BZ2Decompressor()
    while not decompressor.eof:
        compressed = packed.read(_PIECE_BYTES) if decompressor.needs_input else b""
        if decompressor.needs_input and not compressed:
            raise EOFError("the stream is cut short")
        yield decompressor.decompress(compressed, max_length=_PIECE_BYTES)


_PIECES: dict[str, Callable[[Packed], Iterator[bytes | memoryview]]] = {
    "none": lambda packed: iter(lambda: packed.read(_PIECE_BYTES), b""),
    "zstd": zstd_pieces,
    "lz4": _of_lz4,
    "bz2": _of_bz2,
}


_MAGIC = b"\x04\x22\x4d\x18"
_SUMMED, _SIZED, _HAS_DICTIONARY = 0x04, 0x08, 0x01
"""Flags of a frame: a checksum at its end; the size, or a dictionary's id, in its head."""


def unpack(data: memoryview, size: int) -> bytearray:
    """Return the decompressed content of a frame, at most one byte more than `size`.

    Raises
    ------
    EOFError, RuntimeError, ValueError
        If the frame is truncated or invalid, or a checksum does not match.
    """
    head, sums = _head_without_sum(data) if data[:4] == _MAGIC and len(data) > 7 else (b"", False)
    context = lz4.frame.create_decompression_context()
    if head:
        lz4.frame.decompress_chunk(context, head)
    # One byte more than stated, to detect a longer chunk and to reach the frame's end.
    out: bytearray
    out, taken, whole = lz4.frame.decompress_chunk(
        context, data[len(head) :], max_length=size + 1, return_bytearray=True
    )
    if not whole and len(out) <= size:
        raise EOFError("the frame is cut short")
    if whole and sums and data[len(head) + taken :][:4] != _sum_of_content(out):
        raise ValueError("its checksum does not match its bytes")
    return out


def _head_without_sum(data: memoryview) -> tuple[bytes, bool]:
    """Return a frame's header without the content-checksum flag, and whether it was set."""
    flags = data[4]
    end = 6 + (8 if flags & _SIZED else 0) + (4 if flags & _HAS_DICTIONARY else 0)
    if data[end : end + 1] != _sum_of_head(data[4:end]):
        raise ValueError("the checksum of its head does not match its bytes")
    fields = bytes([flags & ~_SUMMED]) + data[5:end]
    return _MAGIC + fields + _sum_of_head(fields), bool(flags & _SUMMED)


def _sum_of_head(fields: bytes | bytearray | memoryview) -> bytes:
    return bytes([xxhash.xxh32_intdigest(fields) >> 8 & 0xFF])


def _sum_of_content(data: bytearray | memoryview) -> bytes:
    return xxhash.xxh32_intdigest(data).to_bytes(4, "little")


_LEVELS = {"zstd": (1, 22), "lz4": (0, 12), "bz2": (1, 9)}


class _Zstd(threading.local):
    """Zstandard contexts of each thread: a new one costs half the time of decompressing a chunk."""

    def __init__(self) -> None:
        self.decompressor = zstandard.ZstdDecompressor()
        self.compressors: dict[int, zstandard.ZstdCompressor] = {}


_zstd = _Zstd()


def decompress(
    codec: str, data: memoryview, size: int, what: str, pool: BufferPool, budget: Budget | None = None
) -> NDArray[np.uint8]:
    """Return the decompressed bytes (size,) of a chunk in a writable array.

    data : compressed bytes
    size : decompressed size stated by the bag, bytes
    what : name of the chunk in error messages
    pool : allocator; memory is taken for actual, not for stated sizes
    budget : limit of the bag
    """
    if codec == "none":
        require_size(len(data), size, what)
        placed = pool.place(size)
        placed.data[:] = data
        return placed
    budget = Budget() if budget is None else budget
    if codec == "bz2" or size > ARENA_BYTES or (codec == "zstd" and not _is_one_frame(data, size)):
        pieces = unpacked(codec, Packed(Source(BytesIO(data), "memory"), len(data), "chunk"), size, what, budget)
        placed, came = pool.place(size), 0
        for piece in pieces:
            placed.data[came : came + len(piece)] = piece
            came += len(piece)
        return placed
    budget.require(size, len(data), what)
    try:
        placed, came = (_unlz4 if codec == "lz4" else _unzstd)(data, size, pool)
    except DAMAGE as error:
        raise BagError(f"{what}: {codec} cannot decompress it: {error}; --recover saves the intact part") from error
    budget.take(came, what)
    require_size(came, size, what)
    return placed


def _unlz4(data: memoryview, size: int, pool: BufferPool) -> tuple[NDArray[np.uint8], int]:
    """Return the decompressed array and how many bytes came out, at most one too many."""
    if size > 255 * len(data):
        raise ValueError(f"{len(data)} bytes cannot become {size}")
    out = unpack(data, size)
    placed = pool.place(len(out))
    placed[:] = np.frombuffer(out, dtype=np.uint8)  # without Python's lock, unlike the copy of a memoryview
    return placed, len(out)


def _unzstd(data: memoryview, size: int, pool: BufferPool) -> tuple[NDArray[np.uint8], int]:
    """Return the decompressed array of a single frame and how many bytes came out."""
    placed = pool.place(size)
    with _zstd.decompressor.stream_reader(data) as reader:
        if (came := reader.readinto(placed.data)) < size:
            raise EOFError(f"the frame is cut short after {came} bytes")
    return placed, came


def _is_one_frame(data: memoryview, size: int) -> bool:
    """Return whether bytes are a single whole Zstandard frame that states this size, by the lengths in it."""
    try:
        found, at, end, last = zstandard.get_frame_parameters(data), zstandard.frame_header_size(data), len(data), 0
    except zstandard.ZstdError:
        return False
    # as `_block` says, without a call for each: a chunk of 1 MB may have hundreds of blocks
    while not last and at + 3 <= end:
        number = data[at] | data[at + 1] << 8 | data[at + 2] << 16
        last = number & 1
        at += 4 if number & 6 == _RUN_LENGTH_BLOCK << 1 else 3 + (number >> 3)
    return bool(last) and at + 4 * found.has_checksum == end and found.content_size == size


def require_level(codec: str, level: int | None) -> None:
    """Raise BagError for a compression level that a codec does not have."""
    if level is None:
        return
    if codec not in _LEVELS:
        raise BagError(f"level {level}: without compression there is none; leave --level out, or give --compression")
    lowest, highest = _LEVELS[codec]
    if not lowest <= level <= highest:
        raise BagError(f"level {level}: {codec} has levels {lowest} to {highest}")


def compress(codec: str, data: NDArray[np.uint8], level: int | None) -> bytes | memoryview:
    """Return the compressed bytes of a chunk's records.

    codec : "zstd", "lz4", "bz2"; any other leaves the data as they are
    level : None is the default: zstd 1, plain LZ4, bz2 9 as bzip2 itself

    LZ4 is fastest with independent blocks of 64 KB: larger or linked ones are copied through its own buffer.
    """
    require_level(codec, level)
    if codec == "zstd":
        level = 1 if level is None else level
        own = _zstd.compressors.get(level) or _zstd.compressors.setdefault(level, zstandard.ZstdCompressor(level=level))
        return own.compress(data.data)
    if codec == "lz4":
        return lz4.frame.compress(data.data, compression_level=level or 0, block_linked=False)
    if codec == "bz2":
        return bz2.compress(data.data, 9 if level is None else level)
    return data.data


def compress_for_ros1(codec: str, data: NDArray[np.uint8], level: int | None) -> bytes | memoryview:
    """Return a chunk compressed for ROS 1, whose LZ4 requires independent blocks, a checksum and no content size."""
    if codec != "lz4":
        return compress(codec, data, level)
    require_level(codec, level)
    frame: bytearray = lz4.frame.compress(
        data.data, compression_level=level or 0, block_linked=False, store_size=False, return_bytearray=True
    )
    frame[4] |= _SUMMED
    frame[6:7] = _sum_of_head(frame[4:6])
    frame += _sum_of_content(data.data)
    return memoryview(frame)

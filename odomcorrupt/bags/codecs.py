"""Chunk compression and decompression: none, bz2, zstd, lz4, and LZ4 frames with the checksum that ROS 1 requires."""

from __future__ import annotations

import bz2
import threading
from contextlib import suppress
from typing import TYPE_CHECKING

import lz4.frame
import numpy as np
import xxhash
import zstandard

from odomcorrupt.bags.budget import Budget
from odomcorrupt.bags.buffer_pool import ARENA_BYTES
from odomcorrupt.bags.codec_streams import DAMAGE, PackedInMemory, end_of_frame, require_size, unpacked
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.bags.buffer_pool import BufferPool

_MAGIC = b"\x04\x22\x4d\x18"
_SUMMED, _SIZED, _HAS_DICTIONARY = 0x04, 0x08, 0x01
"""Flags of a frame: a checksum at its end; the size, or a dictionary's id, in its head."""


def pack_summed(data: NDArray[np.uint8], level: int) -> memoryview:
    """Return a frame of independent blocks with a content checksum and no content size."""
    frame: bytearray = lz4.frame.compress(
        data.data, compression_level=level, block_linked=False, store_size=False, return_bytearray=True
    )
    frame[4] |= _SUMMED
    frame[6:7] = _sum_of_head(frame[4:6])
    frame += _sum_of_content(data.data)
    return memoryview(frame)


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

    def compressor(self, level: int) -> zstandard.ZstdCompressor:
        """Return the compressor of a level, created once."""
        if level not in self.compressors:
            self.compressors[level] = zstandard.ZstdCompressor(level=level)
        return self.compressors[level]


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
        pieces = unpacked(codec, PackedInMemory(data), size, what, budget)
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
    """Return whether bytes are a single whole Zstandard frame that states this size."""
    with suppress(zstandard.ZstdError):
        return zstandard.get_frame_parameters(data).content_size == size and end_of_frame(data) == len(data)
    return False


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
        return _zstd.compressor(1 if level is None else level).compress(data.data)
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
    return pack_summed(data, level or 0)

"""Chunk compressions, by the names users know: none, lz4, zstd, bz2."""

from __future__ import annotations

import bz2
import threading
from typing import TYPE_CHECKING

import lz4.frame
import numpy as np
import zstandard

from odomcorrupt.bags.buffer_pool import SHELF_BYTES
from odomcorrupt.bags.lz4_frames import pack_summed, unpack
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.bags.buffer_pool import BufferPool

__all__ = ["beginning", "compress", "compress_for_ros1", "decompress", "require_level"]

_PIECE_BYTES = 1 << 20
_LEVELS = {"zstd": (1, 22), "lz4": (0, 12), "bz2": (1, 9)}
_LARGEST_BYTES = 1 << 30
"""What a compressed chunk may become: a thousand times what recorders write, and still no danger to a machine."""
_Damage = (zstandard.ZstdError, RuntimeError, OSError, EOFError, ValueError, MemoryError, OverflowError)
"""What the codecs raise on bytes that are not theirs, or on a size no machine has."""


class _Zstd(threading.local):
    """What is used for every chunk: a fresh one costs half as much as it takes to unpack, and threads cannot share."""

    def __init__(self) -> None:
        self.decompressor = zstandard.ZstdDecompressor()
        self.compressors: dict[int, zstandard.ZstdCompressor] = {}

    def compressor(self, level: int) -> zstandard.ZstdCompressor:
        """Return one of a level, whose tables are made once."""
        if level not in self.compressors:
            self.compressors[level] = zstandard.ZstdCompressor(level=level)
        return self.compressors[level]


_zstd = _Zstd()


def decompress(codec: str, data: memoryview, size: int, what: str, shelf: BufferPool) -> NDArray[np.uint8]:
    """Return a chunk's bytes (size,) in a writable array of their own.

    data : the compressed bytes
    size : how many bytes the bag says they become
    what : what errors call the chunk
    shelf : where they are put
    """
    if codec != "none" and size > _LARGEST_BYTES:
        raise BagError(
            f"{what}: says it unpacks to {size} bytes, more than the {_LARGEST_BYTES} that a chunk may; it is damaged, "
            "or to be recorded again in smaller chunks"
        )
    out: bytes | bytearray | memoryview | NDArray[np.uint8]
    try:
        if codec == "zstd":
            out = _unzstd(data, size, shelf)
        elif codec == "lz4":
            out = _unlz4(data, size)
        elif codec == "bz2":
            out = _unbz2(data, size)
        else:
            out = data
    except _Damage as error:
        raise BagError(f"{what}: {codec} cannot decompress it: {error}; --recover saves what is whole") from error
    if len(out) != size:
        raise BagError(
            f"{what}: says it holds {size} bytes, but {len(out)} come out; the bag is damaged, --recover saves "
            "what is whole"
        )
    if isinstance(out, np.ndarray):
        return out
    placed = shelf.place(size)
    placed.data[:] = out
    return placed


def beginning(codec: str, data: bytes) -> bytes:
    """Return what comes out of a compressed chunk that was cut, as far as it goes."""
    try:
        if codec == "zstd":
            return zstandard.ZstdDecompressor().decompressobj().decompress(data)
        if codec == "lz4":
            context = lz4.frame.create_decompression_context()
            out: bytes = lz4.frame.decompress_chunk(context, data, max_length=_LARGEST_BYTES)[0]
            return out
        if codec == "bz2":
            return bz2.BZ2Decompressor().decompress(data, max_length=_LARGEST_BYTES)
    except _Damage:
        return b""
    return data


def _unzstd(data: memoryview, size: int, shelf: BufferPool) -> bytearray | NDArray[np.uint8]:
    stated = zstandard.get_frame_parameters(data).content_size
    if stated == size <= SHELF_BYTES:
        placed = shelf.place(size)
        with _zstd.decompressor.stream_reader(data) as reader:
            if (came := reader.readinto(placed.data)) < size:
                raise EOFError(f"the frame is cut short after {came} bytes")
        return placed
    # The frame does not say, or says otherwise: grow with what really comes, up to the claim and one piece.
    out = bytearray()
    with _zstd.decompressor.stream_reader(data, read_across_frames=True) as reader:
        while len(out) <= size and (piece := reader.read(_PIECE_BYTES)):
            out += piece
    return out


def _unbz2(data: memoryview, size: int) -> bytes:
    decompressor = bz2.BZ2Decompressor()
    out = decompressor.decompress(data, max_length=size + 1)
    if not decompressor.eof and len(out) <= size:
        raise EOFError("the stream is cut short")
    return out


def _unlz4(data: memoryview, size: int) -> bytearray:
    if size > 255 * len(data):
        raise ValueError(f"{len(data)} bytes cannot become {size}")
    return unpack(data, size)


def require_level(codec: str, level: int | None) -> None:
    """Refuse a level that a codec does not have."""
    if level is None:
        return
    if codec not in _LEVELS:
        raise BagError(f"level {level}: without compression there is none; leave --level out, or give --compression")
    lowest, highest = _LEVELS[codec]
    if not lowest <= level <= highest:
        raise BagError(f"level {level}: {codec} has levels {lowest} to {highest}")


def compress(codec: str, data: NDArray[np.uint8], level: int | None) -> bytes | memoryview:
    """Compress a chunk; level None is the fast one (zstd 1, plain LZ4, bz2 9 as bzip2 itself).

    Independent blocks of 64 KB are what LZ4 packs and unpacks fastest: larger or linked ones go through its own buffer.
    """
    require_level(codec, level)
    if codec == "zstd":
        return _zstd.compressor(1 if level is None else level).compress(data.data)
    if codec == "lz4":
        packed: bytes = lz4.frame.compress(data.data, compression_level=level or 0, block_linked=False)
        return packed
    if codec == "bz2":
        return bz2.compress(data.data, 9 if level is None else level)
    return data.data


def compress_for_ros1(codec: str, data: NDArray[np.uint8], level: int | None) -> bytes | memoryview:
    """Compress a chunk so that ROS 1 reads it: its LZ4 wants independent blocks, a checksum, and no content size."""
    if codec != "lz4":
        return compress(codec, data, level)
    require_level(codec, level)
    return pack_summed(data, level or 0)

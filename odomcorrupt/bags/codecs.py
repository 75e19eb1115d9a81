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
from odomcorrupt.bags.buffer_pool import SHELF_BYTES
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from odomcorrupt.bags.buffer_pool import BufferPool

__all__ = ["beginning", "compress", "compress_for_ros1", "decompress", "pack_summed", "require_level", "unpack"]

_MAGIC = b"\x04\x22\x4d\x18"
_SUMMED, _SIZED, _HAS_DICTIONARY = 0x04, 0x08, 0x01
"""Flags of a frame: a checksum at its end; the size, or a dictionary's id, in its head."""


def pack_summed(data: NDArray[np.uint8], level: int) -> bytes:
    """Return a frame of independent blocks with a content checksum and no content size."""
    frame: bytes = lz4.frame.compress(data.data, compression_level=level, block_linked=False, store_size=False)
    fields = bytes([frame[4] | _SUMMED, frame[5]])
    return b"".join((_MAGIC, fields, _sum_of_head(fields), memoryview(frame)[7:], _sum_of_content(data.data)))


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


def _sum_of_head(fields: bytes | memoryview) -> bytes:
    return bytes([xxhash.xxh32_intdigest(fields) >> 8 & 0xFF])


def _sum_of_content(data: bytearray | memoryview) -> bytes:
    return xxhash.xxh32_intdigest(data).to_bytes(4, "little")


_PIECE_BYTES = 1 << 20
_SKIPPABLE_MAGIC = 0x184D2A50
_RUN_LENGTH_BLOCK = 1
"""In a Zstandard frame: one byte that stands for as many as the block's size says."""
_LEVELS = {"zstd": (1, 22), "lz4": (0, 12), "bz2": (1, 9)}
_Damage = (zstandard.ZstdError, RuntimeError, OSError, EOFError, ValueError, MemoryError, OverflowError)
"""What the codecs raise on bytes that are not theirs, or on a size no machine has."""


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
    codec: str, data: memoryview, size: int, what: str, shelf: BufferPool, budget: Budget | None = None
) -> NDArray[np.uint8]:
    """Return the decompressed bytes (size,) of a chunk in a writable array.

    data : compressed bytes
    size : decompressed size stated by the bag, bytes
    what : name of the chunk in error messages
    shelf : allocator; memory is taken for actual, not for stated sizes
    budget : limit of the bag
    """
    if codec == "none":
        _require_size(len(data), size, what)
        placed = shelf.place(size)
        placed.data[:] = data
        return placed
    budget = Budget() if budget is None else budget
    budget.require(size, len(data), what)
    try:
        if codec == "lz4" and size <= SHELF_BYTES:
            out = _unlz4(data, size)
            budget.take(len(out), what)
            _require_size(len(out), size, what)
            placed = shelf.place(len(out))
            placed.data[:] = out
            return placed
        placed = shelf.place(size)
        came = 0
        for piece in _INTO[codec](data, placed):
            came += piece
            budget.take(piece, what)
    except BagError:
        raise
    except _Damage as error:
        raise BagError(f"{what}: {codec} cannot decompress it: {error}; --recover saves what is whole") from error
    _require_size(came, size, what)
    return placed


def _require_size(came: int, size: int, what: str) -> None:
    if came != size:
        raise BagError(
            f"{what}: says it holds {size} bytes, but {came} come out; the bag is damaged, --recover saves "
            "what is whole"
        )


def beginning(codec: str, data: bytes, budget: Budget) -> bytearray:
    """Return the decompressed beginning of a truncated chunk, within the budget."""
    out = bytearray(data if codec == "none" else b"")
    if codec in ("none", "lz4"):
        with suppress(*_Damage):
            if codec == "lz4":
                context = lz4.frame.create_decompression_context()
                most = min(budget.left, 255 * len(data))
                out += lz4.frame.decompress_chunk(context, data, max_length=max(most, 1))[0]
        return out
    budget.require(0, len(data), "")
    piece = np.empty(_PIECE_BYTES, dtype=np.uint8)
    with suppress(*_Damage):
        for came in _pieces_of_cut(codec, data, piece):
            if came >= budget.left:
                break
            budget.take(came, "")
            out += piece.data[:came]
    return out


def _pieces_of_cut(codec: str, data: bytes, piece: NDArray[np.uint8]) -> Iterator[int]:
    """Decompress a truncated chunk piecewise into `piece`; yield the number of bytes each time."""
    if codec == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(data) as reader:
            while came := reader.readinto(piece.data):
                yield came
        return
    decompressor, packed = bz2.BZ2Decompressor(), data
    while not decompressor.eof and (out := decompressor.decompress(packed, max_length=piece.size)):
        packed = b""
        piece.data[: len(out)] = out
        yield len(out)


def _unzstd(data: memoryview, placed: NDArray[np.uint8]) -> Iterator[int]:
    """Decompress into an array; yield the sizes of the pieces, up to the first one too many."""
    sized = zstandard.get_frame_parameters(data).content_size == placed.size <= SHELF_BYTES
    if sized and _end_of_frame(data) == len(data):
        with _zstd.decompressor.stream_reader(data) as reader:
            if (came := reader.readinto(placed.data)) < placed.size:
                raise EOFError(f"the frame is cut short after {came} bytes")
            yield came
        return
    at = 0
    with _zstd.decompressor.stream_reader(data, read_across_frames=True) as reader:
        while at < placed.size and (came := reader.readinto(placed.data[at : at + _PIECE_BYTES])):
            at += came
            yield came
        yield len(reader.read(1)) if at == placed.size else 0
    # of a truncated frame the reader keeps back what it has decompressed beyond what was asked for
    if not _are_whole_frames(data):
        raise EOFError("a frame is cut short")


def _end_of_frame(data: memoryview) -> int:
    """Return where the Zstandard frame ends that bytes begin with, by the lengths in it (RFC 8878, section 3.1).

    Of a truncated frame the end is unknown, and behind that of the bytes.
    """
    if int.from_bytes(data[:4], "little") & ~0xF == _SKIPPABLE_MAGIC:
        return 8 + int.from_bytes(data[4:8], "little")
    parameters = zstandard.get_frame_parameters(data)
    at = zstandard.frame_header_size(data)
    last = 0
    while not last:
        if at + 3 > len(data):
            return len(data) + 1
        head = int.from_bytes(data[at : at + 3], "little")
        last, kind, size = head & 1, head >> 1 & 3, head >> 3
        at += 3 + (1 if kind == _RUN_LENGTH_BLOCK else size)
    return at + (4 if parameters.has_checksum else 0)


def _are_whole_frames(data: memoryview) -> bool:
    """Return whether bytes are whole Zstandard frames."""
    while data:
        end = _end_of_frame(data)
        if end > len(data):
            return False
        data = data[end:]
    return True


def _unbz2(data: memoryview, placed: NDArray[np.uint8]) -> Iterator[int]:
    """Decompress into an array; yield the sizes of the pieces, up to the first one too many."""
    decompressor = bz2.BZ2Decompressor()
    at, packed = 0, data
    while not decompressor.eof and at <= placed.size:
        out = decompressor.decompress(packed, max_length=min(_PIECE_BYTES, placed.size + 1 - at))
        packed = memoryview(b"")
        if not out and not decompressor.eof:
            raise EOFError("the stream is cut short")
        placed.data[at : at + len(out)] = out[: placed.size - at]
        at += len(out)
        yield len(out)


def _unlz4(data: memoryview, size: int) -> bytearray:
    if size > 255 * len(data):
        raise ValueError(f"{len(data)} bytes cannot become {size}")
    return unpack(data, size)


def _unlz4_large(data: memoryview, placed: NDArray[np.uint8]) -> Iterator[int]:
    """Decompress into an array, of which there is no copy; yield the sizes of the pieces, up to the first one too many.

    Raises as `unpack` does.
    """
    if placed.size > 255 * len(data):
        raise ValueError(f"{len(data)} bytes cannot become {placed.size}")
    head, sums = _head_without_sum(data) if data[:4] == _MAGIC and len(data) > 7 else (b"", False)
    context = lz4.frame.create_decompression_context()
    if head:
        lz4.frame.decompress_chunk(context, head)
    at, packed, whole, content = 0, data[len(head) :], False, xxhash.xxh32()
    while not whole and at <= placed.size:
        most = min(_PIECE_BYTES, placed.size + 1 - at)
        out, taken, whole = lz4.frame.decompress_chunk(context, packed, max_length=most)
        if not (out or taken or whole):
            raise EOFError("the frame is cut short")
        placed.data[at : at + len(out)] = out[: placed.size - at]
        content.update(out)
        at, packed = at + len(out), packed[taken:]
        yield len(out)
    if whole and sums and packed[:4] != content.intdigest().to_bytes(4, "little"):
        raise ValueError("its checksum does not match its bytes")


_INTO = {"zstd": _unzstd, "bz2": _unbz2, "lz4": _unlz4_large}


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
    """Return a compressed chunk; level None is the default (zstd 1, plain LZ4, bz2 9 as bzip2 itself).

    LZ4 is fastest with independent blocks of 64 KB: larger or linked ones are copied through its own buffer.
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
    """Return a chunk compressed for ROS 1, whose LZ4 requires independent blocks, a checksum and no content size."""
    if codec != "lz4":
        return compress(codec, data, level)
    require_level(codec, level)
    return pack_summed(data, level or 0)

"""Decompression of chunks in pieces of at most 1 MB, from the bytes of a file or pipe as they are read."""

from __future__ import annotations

import bz2
from contextlib import suppress
from typing import TYPE_CHECKING, Protocol

import lz4.frame
import zstandard

from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from odomcorrupt.bags.budget import Budget
    from odomcorrupt.bags.source import Source

_PIECE_BYTES = 1 << 20
_SKIPPABLE_MAGIC = 0x184D2A50
_RUN_LENGTH_BLOCK = 1
"""In a Zstandard frame: one byte that stands for as many as the block's size says."""
_CHECKSUM_FLAG = 0x04
_SHORTEST_HEAD = 5
"""Of a Zstandard frame: its magic number, and the byte that tells how long the head is."""

DAMAGE = (zstandard.ZstdError, RuntimeError, OSError, EOFError, ValueError, MemoryError, OverflowError)
"""What the codecs raise on bytes that are not theirs, or on a size no machine has."""


class Packed(Protocol):
    """Compressed bytes of a chunk.

    left : bytes not yet read
    """

    left: int

    def read(self, size: int) -> memoryview:
        """Return the next bytes, fewer at the end; valid until the next call."""


class PackedInMemory:
    """Compressed bytes in memory."""

    def __init__(self, data: bytes | memoryview) -> None:
        self._data = memoryview(data)
        self.left = len(data)

    def read(self, size: int) -> memoryview:
        """Return the next bytes, fewer at the end."""
        begin = len(self._data) - self.left
        piece = self._data[begin : begin + size]
        self.left -= len(piece)
        return piece


class PackedInSource:
    """Compressed bytes that are next in a file or pipe.

    source : where they are read from
    size : how many there are
    what : name of the chunk in error messages
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
        raise BagError(
            f"{what}: states {size} bytes, but unpacks to {came}; the bag is damaged, --recover saves the intact part"
        )


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


def _of_none(packed: Packed) -> Iterator[memoryview]:
    while piece := packed.read(_PIECE_BYTES):
        yield piece


def _of_zstd(packed: Packed) -> Iterator[bytes]:
    """Decompress frames block by block (RFC 8878, section 3.1): each becomes 128 kB at most, and a cut is seen."""
    decompressor = zstandard.ZstdDecompressor()
    begun = False
    while packed.left or not begun:
        head, begun = _exactly(packed, _SHORTEST_HEAD), True
        if int.from_bytes(head[:4], "little") & ~0xF == _SKIPPABLE_MAGIC:
            _skip(packed, int.from_bytes(head[4:] + _exactly(packed, 3), "little"))
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


def end_of_frame(data: memoryview) -> int:
    """Return where the Zstandard frame ends that bytes begin with, by the lengths in it.

    Of a truncated frame the end is unknown, and behind that of the bytes.

    Raises
    ------
    zstandard.ZstdError
        If they do not begin as a frame does.
    """
    parameters = zstandard.get_frame_parameters(data)
    at = zstandard.frame_header_size(data)
    last = 0
    # as `_block` says, without a call for each: a chunk of 1 MB may have a hundred blocks
    while not last:
        if at + 3 > len(data):
            return len(data) + 1
        number = data[at] | data[at + 1] << 8 | data[at + 2] << 16
        last = number & 1
        at += 4 if number & 6 == _RUN_LENGTH_BLOCK << 1 else 3 + (number >> 3)
    return at + (4 if parameters.has_checksum else 0)


def _block(head: bytes | memoryview) -> tuple[int, int]:
    """Return whether a block of a Zstandard frame is the last, and its compressed size, bytes, by its head."""
    number = int.from_bytes(head, "little")
    return number & 1, 1 if number >> 1 & 3 == _RUN_LENGTH_BLOCK else number >> 3


def _exactly(packed: Packed, size: int) -> bytes:
    found = bytes(packed.read(size))
    if len(found) < size:
        raise EOFError("a frame is cut short")
    return found


def _skip(packed: Packed, size: int) -> None:
    while size:
        size -= len(_exactly(packed, min(size, _PIECE_BYTES)))


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
    "none": _of_none,
    "zstd": _of_zstd,
    "lz4": _of_lz4,
    "bz2": _of_bz2,
}

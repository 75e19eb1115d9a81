"""LZ4 frames with a content checksum, as ROS 1 requires.

The xxhash package computes the same checksum as the codec in a seventh of the time.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import lz4.frame
import xxhash

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

__all__ = ["pack_summed", "unpack"]

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

"""CRC-32: by ISA-L, which takes a fifth to a fortieth of zlib's time, or by zlib where isal has no wheel.

`crc_of_both` combines the CRCs of two consecutive pieces, so that data shared by many files, and chunks with a CRC
of their own, are read only once for the CRC of the whole file.
"""

from __future__ import annotations

import zlib

__all__ = ["CAN_COMBINE", "combined", "crc32", "crc_of_both"]

try:
    from isal.isal_zlib import crc32, crc32_combine

    CAN_COMBINE = True
    """Whether `crc_of_both` needs no bytes."""
except ImportError:
    crc32 = zlib.crc32
    CAN_COMBINE = False


def crc_of_both(first: int, second: int, piece: bytes | memoryview) -> int:
    """Return the CRC-32 of two consecutive pieces.

    first, second : CRC-32 of each of them
    piece : the second one; only its length is used if `CAN_COMBINE`, else its bytes are
    """
    if CAN_COMBINE:
        return crc32_combine(first, second, len(piece))
    return zlib.crc32(piece, first)


def combined(first: int, second: int, length: int) -> int:
    """Return the CRC-32 of two consecutive pieces, without their bytes.

    first, second : CRC-32 of each of them
    length : length of the second one, bytes; without isal the time grows with it
    """
    if CAN_COMBINE:
        return crc32_combine(first, second, length)
    # A CRC is affine: behind `first`, zeros differ from zeros behind nothing as the second piece would.
    zeros, shifted, plain = bytes(1 << 16), first, 0
    while length:
        piece = memoryview(zeros)[:length]
        shifted, plain, length = zlib.crc32(piece, shifted), zlib.crc32(piece, plain), length - len(piece)
    return shifted ^ plain ^ second

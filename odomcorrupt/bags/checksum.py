"""CRC-32: by ISA-L, which takes a fifth to a fortieth of zlib's time, or by zlib where isal has no wheel.

`combined` gives the CRC of two consecutive pieces from those of each, so that data shared by many files, and chunks
with a CRC of their own, are read only once for the CRC of the whole file.
"""

from __future__ import annotations

import zlib

__all__ = ["combined", "crc32"]


def _combined(first: int, second: int, length: int) -> int:
    """Return what isal's crc32_combine does; the time grows with the length."""
    # A CRC is affine: behind `first`, zeros differ from zeros behind nothing as the second piece would.
    zeros, shifted, plain = bytes(1 << 16), first, 0
    while length:
        piece = memoryview(zeros)[:length]
        shifted, plain, length = zlib.crc32(piece, shifted), zlib.crc32(piece, plain), length - len(piece)
    return shifted ^ plain ^ second


try:
    from isal.isal_zlib import crc32
    from isal.isal_zlib import crc32_combine as combined  # of the CRC-32 of each piece, and the second one's length
except ImportError:
    crc32, combined = zlib.crc32, _combined

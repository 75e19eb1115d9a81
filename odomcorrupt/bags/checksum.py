"""CRC-32: by ISA-L, which takes a fifth to a fortieth of zlib's time, or by zlib where isal has no wheel.

`crc_of_both` gives the sum of two pieces, one behind the other, of their sums and the second one's length: what many
files share, and a chunk that is summed for its own record, is read once for the sum of the whole file, too.
"""

from __future__ import annotations

import zlib

__all__ = ["CAN_COMBINE", "crc32", "crc_of_both"]

try:
    from isal.isal_zlib import crc32, crc32_combine

    CAN_COMBINE = True
    """Whether `crc_of_both` needs no bytes."""
except ImportError:
    crc32 = zlib.crc32
    CAN_COMBINE = False


def crc_of_both(first: int, second: int, piece: bytes | memoryview) -> int:
    """Return the CRC-32 of two pieces, one behind the other.

    Parameters
    ----------
    first, second : int
        CRC-32 of each of them.
    piece : bytes | memoryview
        The second one: its length is all that matters where `CAN_COMBINE`, else it is summed again.

    """
    if CAN_COMBINE:
        both: int = crc32_combine(first, second, len(piece))
        return both
    return zlib.crc32(piece, first)

"""CRC-32 of bytes that were summed before: what many files share is summed once.

The sum of two pieces, one behind the other, follows from their sums and the second one's length: zeros are appended
to the first by a linear map over GF(2), the second is added. The maps for 1, 2, 4 ... zero bytes are squares of each
other.
"""

from __future__ import annotations

from functools import cache

__all__ = ["crc_of_both"]

_POLYNOMIAL = 0xEDB88320


def crc_of_both(first: int, second: int, length: int) -> int:
    """Return the CRC-32 of two pieces, of their CRC-32s and the length of the second in bytes."""
    power = 0
    while length and first:
        if length & 1:
            first = _times(_appending(power), first)
        length >>= 1
        power += 1
    return first ^ second


@cache
def _appending(power: int) -> tuple[int, ...]:
    """Return the map (32 columns) that appends 2^power zero bytes."""
    if power:
        half = _appending(power - 1)
        return tuple(_times(half, column) for column in half)
    one_bit = (_POLYNOMIAL, *(1 << bit for bit in range(31)))
    two = tuple(_times(one_bit, column) for column in one_bit)
    four = tuple(_times(two, column) for column in two)
    return tuple(_times(four, column) for column in four)


def _times(columns: tuple[int, ...], vector: int) -> int:
    total = 0
    for column in columns:
        if not vector:
            break
        if vector & 1:
            total ^= column
        vector >>= 1
    return total

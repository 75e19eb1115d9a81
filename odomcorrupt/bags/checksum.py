"""CRC-32 of bytes that were summed before: what many files share, and chunks of which little changes, are summed once.

The sum of two pieces, one behind the other, follows from their sums and the second one's length: zeros are appended
to the first by a linear map over GF(2), the second is added. The maps for 1, 2, 4 ... zero bytes are squares of each
other. In the same way a change adds the sum of old xor new bytes, with as many zeros appended as bytes follow it.
"""

from __future__ import annotations

import zlib
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.spans import windows

if TYPE_CHECKING:
    from odomcorrupt.bags.block import Block
    from odomcorrupt.bags.messages import Layout

__all__ = ["Resummed", "crc_of_both"]

_ONES = 0xFFFFFFFF
_WORTH = 4
"""The part of a block that may change, one in so many: above, summing anew is quicker."""

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


class Resummed:
    """What messages of a block held before they were written to, so that its chunks need not be summed anew.

    Begin before the first write, and `finish` behind the last: the block then knows its chunks' CRC-32. Nothing but
    messages of these layouts may have changed, and nothing behind their last numbers.
    """

    def __init__(self, block: Block, layouts: list[Layout]) -> None:
        self._block = block
        self._layouts = list({id(layout): layout for layout in layouts}.values())
        changing = sum(len(layout.starts) * layout.size for layout in self._layouts)
        self._known = bool(block.read_crcs) and changing * _WORTH <= block.data.size
        self._before = [self._bytes(layout) for layout in self._layouts] if self._known else []

    def _bytes(self, layout: Layout) -> np.ndarray[tuple[int, int], np.dtype[np.uint8]]:
        held = windows(self._block.data, layout.size)[layout.starts]
        return held.view(np.uint8).reshape(-1, layout.size)

    def finish(self) -> None:
        """Tell the block what its chunks sum up to."""
        if not self._known:
            return
        block = self._block
        ends = np.array(block.ends or (block.data.size,), dtype=np.int64)
        crcs = np.array(block.read_crcs, dtype=np.uint32)
        for layout, before in zip(self._layouts, self._before, strict=True):
            size = layout.size
            changed = (before ^ self._bytes(layout)).reshape(-1).data
            sums = [zlib.crc32(changed[at : at + size], _ONES) ^ _ONES for at in range(0, len(changed), size)]
            chunks = np.searchsorted(ends, layout.starts, side="right")
            np.bitwise_xor.at(crcs, chunks, _with_zeros(np.array(sums, np.uint32), ends[chunks] - layout.starts - size))
        block.crcs = tuple(crcs.tolist())


def _with_zeros(
    sums: np.ndarray[tuple[int], np.dtype[np.uint32]], counts: np.ndarray[tuple[int], np.dtype[np.int64]]
) -> np.ndarray[tuple[int], np.dtype[np.uint32]]:
    """Return sums (n,) without the ones that a CRC-32 begins and ends with, counts (n,) zero bytes appended."""
    out = sums.copy()
    for power in range(int(counts.max(initial=0)).bit_length()):
        rows = np.flatnonzero(counts >> power & 1)
        of = out[rows]
        table = _table(power)
        out[rows] = table[0][of & 255] ^ table[1][of >> 8 & 255] ^ table[2][of >> 16 & 255] ^ table[3][of >> 24]
    return out


@cache
def _table(power: int) -> np.ndarray[tuple[int, int], np.dtype[np.uint32]]:
    """Return what each value of each of the four bytes of a sum becomes where 2^power zero bytes are appended."""
    columns = np.array(_appending(power), dtype=np.uint32).reshape(4, 8)
    table = np.zeros((4, 256), dtype=np.uint32)
    for bit in range(8):
        table[:, 1 << bit : 2 << bit] = table[:, : 1 << bit] ^ columns[:, bit, None]
    return table


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

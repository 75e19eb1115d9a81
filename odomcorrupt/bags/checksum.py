"""CRC-32 of bytes that were summed before: what many files share, and chunks of which little changes, are summed once.

The sum of two pieces, one behind the other, follows from their sums and the second one's length: zeros are appended
to the first by a linear map over GF(2), the second is added. The maps for 1, 2, 4 ... zero bytes are squares of each
other; those for 1 to 15 times 1, 16, 256 ... are kept as tables, so that a few look-ups append any count of them. In
the same way a change adds the sum of old xor new bytes, with as many zeros appended as bytes follow it.
"""

from __future__ import annotations

import zlib
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.bags.gaps import windows

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Block
    from odomcorrupt.bags.messages import Layout

__all__ = ["IncrementalCrc", "crc_of_both"]

_ONES = 0xFFFFFFFF
_WORTH = 4
"""The part of a block that may change, one in so many: above, summing anew is quicker."""

_POLYNOMIAL = 0xEDB88320
_DIGIT_BITS, _DIGIT = 4, 15
"""Counts of zero bytes are taken apart into digits of so many bits."""


def crc_of_both(first: int, second: int, length: int) -> int:
    """Return the CRC-32 of two pieces, of their CRC-32s and the length of the second in bytes."""
    for place in range(0, length.bit_length(), _DIGIT_BITS):
        first = int(_appended(first, place, length >> place & _DIGIT))
    return first ^ second


class IncrementalCrc:
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

    def _bytes(self, layout: Layout) -> NDArray[np.uint8]:
        held = windows(self._block.data, layout.size)[layout.starts]
        return held.view(np.uint8).reshape(-1, layout.size)

    def finish(self) -> None:
        """Tell the block what its chunks sum up to."""
        if not self._known:
            return
        block = self._block
        ends = np.array(block.ends or (block.data.size,), dtype=np.int64)
        crcs = np.array(block.read_crcs, dtype=np.uint32)
        sums: list[int] = []
        for layout, before in zip(self._layouts, self._before, strict=True):
            size = layout.size
            changed = (before ^ self._bytes(layout)).reshape(-1).data
            sums += [zlib.crc32(changed[at : at + size], _ONES) ^ _ONES for at in range(0, len(changed), size)]
        stops = np.concatenate([layout.starts + layout.size for layout in self._layouts])
        chunks = np.searchsorted(ends, stops)
        np.bitwise_xor.at(crcs, chunks, _with_zeros(np.array(sums, dtype=np.uint32), ends[chunks] - stops))
        block.crcs = tuple(crcs.tolist())


def _with_zeros(sums: NDArray[np.uint32], counts: NDArray[np.int64]) -> NDArray[np.uint32]:
    """Return sums (n,) without the ones that a CRC-32 begins and ends with, counts (n,) zero bytes appended."""
    for place in range(0, int(counts.max(initial=0)).bit_length(), _DIGIT_BITS):
        sums = _appended(sums, place, counts >> place & _DIGIT)
    return sums


def _appended(sums: Any, place: int, digits: Any) -> Any:
    """Return sums, one or (n,), with digits times 2^place zero bytes appended."""
    table = _table(place)
    low = table[digits, 0, sums & 255] ^ table[digits, 1, sums >> 8 & 255]
    return low ^ table[digits, 2, sums >> 16 & 255] ^ table[digits, 3, sums >> 24]


@cache
def _table(place: int) -> NDArray[np.uint32]:
    """Return (16, 4, 256): what each value of each byte of a sum becomes where 0 to 15 times 2^place zeros follow."""
    maps = np.empty((_DIGIT + 1, 32), dtype=np.uint32)
    maps[0] = 1 << np.arange(32)
    for bit in range(_DIGIT_BITS):
        maps[1 << bit : 2 << bit] = _mapped(_appending(place + bit), maps[: 1 << bit])
    columns = maps.reshape(-1, 4, 8, 1)
    table = np.zeros((_DIGIT + 1, 4, 256), dtype=np.uint32)
    for bit in range(8):
        table[..., 1 << bit : 2 << bit] = table[..., : 1 << bit] ^ columns[:, :, bit]
    return table


@cache
def _appending(power: int) -> NDArray[np.uint32]:
    """Return the map, 32 columns, that appends 2^power zero bytes."""
    if power:
        half = _appending(power - 1)
        return _mapped(half, half)
    one_bit = np.array((_POLYNOMIAL, *(1 << bit for bit in range(31))), dtype=np.uint32)
    two = _mapped(one_bit, one_bit)
    four = _mapped(two, two)
    return _mapped(four, four)


def _mapped(columns: NDArray[np.uint32], sums: NDArray[np.uint32]) -> NDArray[np.uint32]:
    """Return what a map makes of sums."""
    chosen = np.where(sums[..., None] >> np.arange(32, dtype=np.uint32) & 1, columns, 0)
    mapped: NDArray[np.uint32] = np.bitwise_xor.reduce(chosen, axis=-1, dtype=np.uint32)
    return mapped

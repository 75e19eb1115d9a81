"""Where chunks are unpacked to: side by side in one buffer, so that numpy works on many of them at once.

A chunk of a robot with a camera has a dozen odometry messages, and a numpy call costs as much as a hundred. Fresh
memory costs as much as unpacking into it, so a buffer that nobody looks at any more is taken again.
"""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["SHELF_BYTES", "Shelf"]

SHELF_BYTES = 8 << 20
"""Chunks are put together up to this: more would save no more time. A larger one stands alone."""


class Shelf:
    """Holds the chunks of one block after the other.

    room : bytes that are left for chunks of the present block
    """

    def __init__(self) -> None:
        self._free: list[bytearray] = []
        self._begin = self._end = SHELF_BYTES
        self._buffer: NDArray[np.uint8] = np.empty(0, dtype=np.uint8)

    @property
    def room(self) -> int:
        """How many bytes more the present block may have; a block without any has always room for one chunk."""
        return SHELF_BYTES - self._end

    def place(self, size: int) -> NDArray[np.uint8]:
        """Return the next bytes (size,), writable; they are not kept before `keep`."""
        if self._begin == self._end and size > self.room:
            self._take_buffer()
        return self._buffer[self._end : self._end + size]

    def keep(self, size: int) -> None:
        """Count bytes to the present block."""
        self._end += size

    def cut(self) -> NDArray[np.uint8]:
        """Return the present block's bytes, and begin the next one behind them."""
        block = self._buffer[self._begin : self._end]
        self._begin = self._end
        return block

    def _take_buffer(self) -> None:
        memory = self._free.pop() if self._free else bytearray(SHELF_BYTES)
        self._buffer = np.frombuffer(memory, dtype=np.uint8)
        # Every block is a view of this array: when the last one has gone, the memory is free again.
        weakref.finalize(self._buffer, self._free.append, memory).atexit = False
        self._begin = self._end = 0

"""Buffers for decompressed chunks, placed side by side so that NumPy can process many of them at once.

New memory costs more than decompressing into it, so a buffer without references is used again.
"""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

ARENA_BYTES = 8 << 20
"""What is put side by side: with less, NumPy has fewer messages at once; more does not stay in the cache."""


class BufferPool:
    """Allocator of chunk buffers."""

    def __init__(self) -> None:
        self._free: list[NDArray[np.uint8]] = []
        self._buffer: NDArray[np.uint8] = np.empty(0, dtype=np.uint8)
        self._used = 0

    def place(self, size: int) -> NDArray[np.uint8]:
        """Return a writable buffer (size,), placed directly after the previous one if there is room."""
        if size > ARENA_BYTES:
            return np.empty(size, dtype=np.uint8)
        if size > self._buffer.size - self._used:
            self._take_buffer()
        self._used += size
        return self._buffer[self._used - size : self._used]

    def _take_buffer(self) -> None:
        self._buffer = np.empty(0, dtype=np.uint8)
        # not zeroed: a short bag never touches most of it
        memory = self._free.pop() if self._free else np.empty(ARENA_BYTES, dtype=np.uint8)
        self._buffer = np.frombuffer(memory.data, dtype=np.uint8)
        # All buffers are views of this array: without the last of them, the memory is free.
        weakref.finalize(self._buffer, self._free.append, memory).atexit = False
        self._used = 0

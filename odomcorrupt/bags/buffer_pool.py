"""Where chunks are unpacked to: one behind the other in a buffer, so that numpy can work on many of them at once.

Fresh memory costs more than unpacking into it, so a buffer that nobody looks at any more is taken again.
"""

from __future__ import annotations

import weakref
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["SHELF_BYTES", "BufferPool"]

SHELF_BYTES = 12 << 20
"""What is put side by side: more would save no more time."""


class BufferPool:
    """Gives room for chunks."""

    def __init__(self) -> None:
        self._free: list[NDArray[np.uint8]] = []
        self._buffer: NDArray[np.uint8] = np.empty(0, dtype=np.uint8)
        self._used = 0

    def place(self, size: int) -> NDArray[np.uint8]:
        """Return writable bytes (size,) of their own, behind those given last where there is room."""
        if size > SHELF_BYTES:
            return np.empty(size, dtype=np.uint8)
        if size > self._buffer.size - self._used:
            self._take_buffer()
        self._used += size
        return self._buffer[self._used - size : self._used]

    def _take_buffer(self) -> None:
        self._buffer = np.empty(0, dtype=np.uint8)
        # not zeroed: of a short bag most of it is never touched
        memory = self._free.pop() if self._free else np.empty(SHELF_BYTES, dtype=np.uint8)
        self._buffer = np.frombuffer(memory.data, dtype=np.uint8)
        # Whatever is given is a view of this array: when the last one has gone, the memory is free again.
        weakref.finalize(self._buffer, self._free.append, memory).atexit = False
        self._used = 0

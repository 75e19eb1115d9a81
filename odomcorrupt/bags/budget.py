"""Limits on decompressed sizes, against small bags that expand to a machine's memory.

A size is refused when it is stated, before memory is taken; what comes out is counted, so that a bag that states
less than it holds gets no further.
"""

from __future__ import annotations

import os
import re
import weakref
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray


VARIABLE = "ODOMCORRUPT_MAX_UNPACKED"
"""Environment variable that sets the allowance of a chunk and of a bag; processes of a batch inherit it."""

_TIMES = 1000
"""What a bag may unpack to, in its own size, beyond the allowance; recorders reach 2 to 50, black images a thousand."""

_UNITS = {"B": 1, "K": 1 << 10, "M": 1 << 20, "G": 1 << 30, "T": 1 << 40}
_SIZE = re.compile(r"([0-9]{1,15}(?:\.[0-9]{1,15})?) *(B|[KMGT](?:I?B)?)", re.IGNORECASE)


class _Allowance(NamedTuple):
    """Decompressed bytes of any chunk, and of any bag beyond a multiple of its own size."""

    chunk: int
    bag: int


_DEFAULT = (1 << 30, 128 << 20)
"""So much stays below 300 MB of memory for a bag of 100 kB, together with what Python takes."""


def size_of(text: str) -> int:
    """Return a size in bytes: "4GiB", "500 MB", "4G" or "1000B"; units are of 1024.

    Raises
    ------
    ValueError
        If it is none, or zero.
    """
    found = _SIZE.fullmatch(text.strip())
    size = int(float(found[1]) * _UNITS[found[2][0].upper()]) if found else 0
    if not size:
        raise ValueError(f"{text!r} is not a size; write one such as 4GiB or 500MB")
    return size


@contextmanager
def limited(size: int | None) -> Iterator[None]:
    """Let chunks and bags unpack to `size` bytes in this process and those it starts; None: as before."""
    before = os.environ.get(VARIABLE)
    if size is not None:
        os.environ[VARIABLE] = f"{size}B"
    try:
        yield
    finally:
        if size is not None:
            os.environ.pop(VARIABLE)
            if before is not None:
                os.environ[VARIABLE] = before


class Budget:
    """Remaining decompressed bytes of a bag in one pass."""

    def __init__(self) -> None:
        self._packed = self._unpacked = 0

    @cached_property
    def _allowance(self) -> _Allowance:
        text = os.environ.get(VARIABLE)
        if text is None:
            return _Allowance(*_DEFAULT)
        try:
            size = size_of(text)
        except ValueError as error:
            raise BagError(f"{VARIABLE}: {error}") from error
        return _Allowance(size, size)

    def require(self, size: int, packed: int, what: str) -> None:
        """Count the compressed bytes of a chunk; raise BagError if its stated size is too large.

        The limit of a bag grows with the compressed bytes that were read.
        """
        self._packed += packed
        if size > self._allowance.chunk:
            raise BagError(
                f"{what}: states that it unpacks to {size} bytes, more than the {self._allowance.chunk} that a chunk "
                f"may; it is damaged, or to be recorded again in smaller chunks; {_advice(size)}"
            )
        if size > self.left:
            raise BagError(
                f"{what}: states that it unpacks to {size} bytes; the bag would unpack to {self._unpacked + size} "
                f"bytes from {self._packed}, a ratio that no recording has; {_advice(self._unpacked + size)}"
            )

    def take(self, size: int, what: str) -> None:
        """Count decompressed bytes; raise BagError beyond the limit."""
        self._unpacked += size
        if self.left <= 0:
            raise BagError(
                f"{what}: up to here {self._packed} bytes have unpacked to {self._unpacked}, a ratio that no recording "
                f"has; {_advice(self._unpacked + 1)}"
            )

    @property
    def left(self) -> int:
        """Remaining bytes."""
        return self._allowance.bag + _TIMES * self._packed - self._unpacked


def _advice(size: int) -> str:
    gib = 1 << max((size - 1).bit_length() - 30, 0)
    return f"--max-unpacked {gib}GiB allows it"


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

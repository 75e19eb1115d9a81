"""Limits on decompressed sizes, against small bags that expand to a machine's memory."""

from __future__ import annotations

import os
from functools import cached_property

from odomcorrupt.errors import BagError

__all__ = ["VARIABLE", "Budget"]

VARIABLE = "ODOMCORRUPT_UNPACK_GIB"
"""Environment variable that sets the allowance of a chunk and of a bag, GiB."""

_TIMES = 1000
"""What a bag may unpack to, in its own size, beyond the allowance; recorders reach 2 to 50, black images a thousand."""


class Budget:
    """Remaining decompressed bytes of a bag in one pass."""

    def __init__(self) -> None:
        self._packed = self._unpacked = 0

    @cached_property
    def allowance(self) -> int:
        """Bytes that any chunk and any bag may decompress to; 1 GiB, or as of the environment variable."""
        text = os.environ.get(VARIABLE, "1")
        try:
            return int(float(text) * (1 << 30))
        except (ValueError, OverflowError) as error:
            raise BagError(f"{VARIABLE}: is {text!r}; write a number of GiB") from error

    def require_chunk(self, size: int, what: str) -> None:
        """Raise BagError for a chunk whose stated size is too large."""
        if size > self.allowance:
            raise BagError(
                f"{what}: says it unpacks to {size} bytes, more than the {self.allowance} that a chunk may; it is "
                f"damaged, or to be recorded again in smaller chunks; {VARIABLE}=N allows N GiB"
            )

    def read(self, size: int) -> None:
        """Count compressed bytes read, in proportion to which the limit grows."""
        self._packed += size

    def take(self, size: int, what: str) -> None:
        """Count decompressed bytes; raise BagError beyond the limit."""
        self._unpacked += size
        if self.left <= 0:
            raise BagError(
                f"{what}: with it {self._unpacked} bytes have come out of {self._packed}, which no recording packs so "
                f"small; {VARIABLE}=N allows N GiB"
            )

    @property
    def left(self) -> int:
        """Remaining bytes."""
        return self.allowance + _TIMES * self._packed - self._unpacked

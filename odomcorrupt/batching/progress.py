"""Progress of a pass over a bag."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from collections.abc import Container, Iterator

    from odomcorrupt.bags.block import BagReader, Block

__all__ = ["PAUSE_S", "ProgressCallback", "Watched"]

PAUSE_S = 0.3
"""Time between two beats."""


class ProgressCallback(Protocol):
    """Callback for progress."""

    def __call__(self, part: float | None, past_s: float, /) -> None:
        """Process the part of the bag's bytes read, 0 to 1 or None where unknown, and the seconds of recorded time."""


class Watched:
    """A reader that reports progress; otherwise equal to the given reader."""

    def __init__(self, reader: BagReader, beat: ProgressCallback) -> None:
        self._reader = reader
        self._beat = beat

    def __getattr__(self, name: str) -> Any:
        return getattr(self._reader, name)

    def blocks(self, only: Container[int] | None = None) -> Iterator[Block]:
        """Yield the reader's blocks."""
        next_s = time.monotonic() + PAUSE_S
        first_ns: int | None = None
        for block in self._reader.blocks(only):
            yield block
            if len(block.table):
                first_ns = int(block.table["log_ns"][0]) if first_ns is None else first_ns
            if first_ns is not None and len(block.table) and time.monotonic() >= next_s:
                next_s = time.monotonic() + PAUSE_S
                past_s = (int(block.table["log_ns"][-1]) - first_ns) * 1e-9
                self._beat(getattr(self._reader, "part_read", None), past_s)

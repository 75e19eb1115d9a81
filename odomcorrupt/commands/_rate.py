"""How far a batch has got: rate and time left, on terminals only."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Self

import click

if TYPE_CHECKING:
    from types import TracebackType

__all__ = ["Rate", "left_words"]


class Rate:
    """Counts runs, and says on stderr how many a second and how long the rest takes."""

    def __init__(self, total: int) -> None:
        self._total = total
        self._done = 0
        self._shown = sys.stderr.isatty()
        self._begun_s = time.monotonic()

    def add(self, count: int) -> None:
        """Take note of runs that are made."""
        self._done += count
        if self._shown:
            line = left_words(self._done, self._total, time.monotonic() - self._begun_s)
            click.echo(f"\r\x1b[K{line}", nl=False, err=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._shown:
            click.echo("\r\x1b[K", nl=False, err=True)


def left_words(done: int, total: int, spent_s: float) -> str:
    """Return runs made, rate and time left in words."""
    rate = done / spent_s if spent_s > 0.0 else 0.0
    if rate <= 0.0:
        return f"{done} of {total} runs"
    left_s = (total - done) / rate
    shown = (
        f"{left_s:.0f} s"
        if left_s < 120.0
        else f"{left_s / 60.0:.0f} min"
        if left_s < 7200.0
        else f"{left_s / 3600.0:.1f} h"
    )
    return f"{done} of {total} runs, {rate:.3g} a second, {shown} left"

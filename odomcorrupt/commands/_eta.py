"""How far a batch has got: rate and time left, on terminals only."""

from __future__ import annotations

import sys
import time
from typing import TYPE_CHECKING, Self

import click

if TYPE_CHECKING:
    from types import TracebackType

    from odomcorrupt.batching.job import Task
    from odomcorrupt.batching.runner import Failure

__all__ = ["Rate", "left_words"]


class Rate:
    """Counts runs, those of passes that are under way in parts, and says on stderr how long the rest takes.

    shown : whether anybody reads it
    failures : of the runs that are done
    """

    def __init__(self, total: int, *, quiet: bool = False) -> None:
        self.shown = sys.stderr.isatty() and not quiet
        self.failures: list[Failure] = []
        self._total = total
        self._done = 0
        self._begun_s = time.monotonic()
        self._parts: dict[tuple[str, tuple[int, ...]], tuple[int, float]] = {}

    def done(self, task: Task, failures: list[Failure]) -> None:
        """Take note of runs that are made."""
        self.failures.extend(failures)
        self._parts.pop((task.job.shown_directory, task.runs), None)
        self._done += len(task.runs)
        self._say("")

    def under_way(self, task: Task, part: float | None, past_s: float) -> None:
        """Take note of a pass: the part of the bag that is read, None where it cannot be told, and its seconds."""
        if part is not None:
            self._parts[task.job.shown_directory, task.runs] = len(task.runs), part
        self._say(f"; a pass of {len(task.runs)} is at {past_s:.0f} s of the bag")

    def _say(self, more: str) -> None:
        if self.shown:
            parts = sum(runs * part for runs, part in self._parts.values())
            line = left_words(self._done + parts, self._total, time.monotonic() - self._begun_s)
            click.echo(f"\r\x1b[K{line}{more}", nl=False, err=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.shown:
            click.echo("\r\x1b[K", nl=False, err=True)


def left_words(done: float, total: int, spent_s: float) -> str:
    """Return runs made, rate and time left in words; half a run counts for both of these."""
    rate = done / spent_s if spent_s > 0.0 else 0.0
    if rate <= 0.0:
        return f"{int(done)} of {total} runs"
    left_s = (total - done) / rate
    shown = (
        f"{left_s:.0f} s"
        if left_s < 120.0
        else f"{left_s / 60.0:.0f} min"
        if left_s < 7200.0
        else f"{left_s / 3600.0:.1f} h"
    )
    return f"{int(done)} of {total} runs, {rate:.3g} a second, {shown} left"

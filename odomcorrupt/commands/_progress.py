"""Progress on stderr, on terminals only: seconds and bytes of a bag, stages of a study, runs of a batch."""

from __future__ import annotations

import sys
import threading
import time
from typing import TYPE_CHECKING, Self

import click

if TYPE_CHECKING:
    from odomcorrupt.bags.block import Block
    from odomcorrupt.batching.engine import Failure
    from odomcorrupt.batching.job import Task

PAUSE_S = 0.2
"""Interval between two updates of the line, seconds."""
FIRST_S = 1.0
"""Time before the first update, seconds; shorter work shows no progress."""
_READING, _MATCHING = 0.25, 0.5
"""Usual fraction of the work that reading takes, without and with scans to match."""


def _duration(seconds: float) -> str:
    if seconds < 120.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


class _Line:
    """A line on stderr that is overwritten; nothing is printed without a terminal or with --quiet.

    shown : whether the line is printed
    """

    def __init__(self, *, quiet: bool = False) -> None:
        self.shown = sys.stderr.isatty() and not quiet
        self._begun_s = time.monotonic()

    def _say(self, words: str) -> None:
        if self.shown:
            click.echo(f"\r\x1b[K{words}", nl=False, err=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._say("")


class Progress(_Line):
    """Progress of a bag, block by block."""

    def __init__(self, *, quiet: bool = False) -> None:
        super().__init__(quiet=quiet)
        self._next_s = self._begun_s + PAUSE_S
        self._bytes = 0
        self._first_ns: int | None = None

    def __call__(self, block: Block) -> None:
        """Count a block."""
        if not self.shown or not len(block.table):
            return
        self._bytes += block.data.size
        if self._first_ns is None:
            self._first_ns = int(block.table["log_ns"][0])
        if time.monotonic() >= self._next_s:
            self._next_s = time.monotonic() + PAUSE_S
            past_s = (int(block.table["log_ns"][-1]) - self._first_ns) * 1e-9
            self._say(f"{past_s:.0f} s of the bag, {self._bytes / 1e6:.0f} MB")


class Stages(_Line):
    """Progress of a study: its stage, the completed fraction and the remaining time.

    Reading comes first. Its part of the work is unknown: a quarter is usual, half if scans are matched. The time
    remaining after it is estimated from the later stages alone.
    """

    def __init__(self, stage: str = "reading", *, quiet: bool = False) -> None:
        super().__init__(quiet=quiet)
        self._stage, self._share, self._end_s = stage, 0.0, 0.0
        self._read: tuple[float, float] | None = None
        self._ended = threading.Event()
        self._ticker = threading.Thread(target=self._tick, daemon=True)

    def reading(self, stage: str, share: float) -> None:
        """Record a stage of reading, and the fraction of all reading completed before it."""
        part = _READING if stage == "reading" else _MATCHING
        self._note(stage, part * share, part * share, self._begun_s)

    def __call__(self, stage: str, share: float) -> None:
        """Record the beginning of a stage, and the fraction of the work after reading completed before it."""
        if self._read is None:
            self._read = self._share, time.monotonic()
        first, since_s = self._read
        self._note(stage, first + (1.0 - first) * share, share, since_s)

    def _note(self, stage: str, share: float, part: float, since_s: float) -> None:
        """Record the completed fraction of the work, and the fraction completed since a time."""
        now_s = time.monotonic()
        # fraction completed before the remaining time is estimated
        end_s = now_s + (now_s - since_s) * (1.0 - part) / part if part >= 0.05 else 0.0
        self._stage, self._share, self._end_s = stage, max(self._share, share), end_s

    def _tick(self) -> None:
        while not self._ended.wait(PAUSE_S):
            now_s = time.monotonic()
            if now_s - self._begun_s >= FIRST_S:
                words = [self._stage, f"{now_s - self._begun_s:.0f} s"]
                words += [f"{int(100.0 * self._share)} % done"] if self._share > 0.0 else []
                words += [f"about {_duration(self._end_s - now_s)} left"] if self._end_s > now_s + 1.0 else []
                self._say(", ".join(words))

    def __enter__(self) -> Self:
        if self.shown:
            self._ticker.start()
        return self

    def __exit__(self, *_error: object) -> None:
        self._ended.set()
        if self._ticker.is_alive():
            self._ticker.join()
        super().__exit__()


class Rate(_Line):
    """Progress of a batch: completed runs, including fractions of passes in progress, and the remaining time.

    failures : failures of the completed runs
    """

    def __init__(self, total: int, *, quiet: bool = False) -> None:
        super().__init__(quiet=quiet)
        self.failures: list[Failure] = []
        self._total = total
        self._done = 0
        self._parts: dict[tuple[str, tuple[int, ...]], tuple[int, float]] = {}

    def done(self, task: Task, failures: list[Failure]) -> None:
        """Count completed runs."""
        self.failures.extend(failures)
        self._parts.pop((task.job.shown_directory, task.runs), None)
        self._done += len(task.runs)
        self._count("")

    def under_way(self, task: Task, part: float | None, past_s: float) -> None:
        """Record a pass in progress: the fraction of the bag read (None if unknown), and its position in seconds."""
        if part is not None:
            self._parts[task.job.shown_directory, task.runs] = len(task.runs), part
        self._count(f"; a pass of {len(task.runs)} is at {past_s:.0f} s of the bag")

    def _count(self, more: str) -> None:
        parts = sum(runs * part for runs, part in self._parts.values())
        done, spent_s = self._done + parts, time.monotonic() - self._begun_s
        said, rate = f"{int(done)} of {self._total} runs", done / spent_s if spent_s > 0.0 else 0.0
        if rate > 0.0:
            said += f", {rate:.3g} a second, {_duration((self._total - done) / rate)} left"
        self._say(said + more)

"""Estimate of a batch's size and time, measured on the beginning of its bag."""

from __future__ import annotations

import shutil
import tempfile
import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odomcorrupt.batching.engine import count_missing
from odomcorrupt.batching.job import Task
from odomcorrupt.batching.manifest import PARTS, bytes_of
from odomcorrupt.batching.runner import make
from odomcorrupt.errors import BatchError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from odomcorrupt.bags.block import BagReader, Block
    from odomcorrupt.batching.engine import Shard
    from odomcorrupt.batching.job import Job

TRIED_BYTES = 32 << 20
"""How much of a bag is tried, decompressed."""

TRIED_RUNS = 4


@dataclass(frozen=True, slots=True)
class Estimate:
    """Cost of one run: bytes, seconds of one core, and bytes as an overlay."""

    bytes: int
    seconds: float
    overlay_bytes: int


@dataclass(frozen=True, slots=True)
class Need:
    """Cost of a number of runs, and the free bytes of the target's file system."""

    runs: int
    bytes: int
    core_seconds: float
    overlay_bytes: int
    free_bytes: int


class _First:
    """The beginning of a bag; otherwise equal to the given reader."""

    def __init__(self, reader: BagReader) -> None:
        self._reader, self.read_bytes, self.cut = reader, 0, False

    def __getattr__(self, name: str) -> Any:
        return getattr(self._reader, name)

    def blocks(self, only: Any = None) -> Iterator[Block]:  # noqa: ARG002 - the protocol's signature
        """Yield blocks until `TRIED_BYTES`, and beyond it until there has been odometry."""
        self.read_bytes = 0
        for block in self._reader.blocks():
            self.read_bytes += block.data.size
            yield block
            if self.read_bytes >= TRIED_BYTES:
                self.cut = True
                return


def estimate(job: Job) -> Estimate:
    """Return the cost of one run, from a few runs on the beginning of the bag in a temporary directory."""
    size = bytes_of(job.source)
    with tempfile.TemporaryDirectory() as scratch:
        plain = replace(job.batch.container, compression=None, level=None)
        whole = _try(job, 1, Path(scratch) / "full", output="full", container=plain, split=False)
        chosen = _try(job, TRIED_RUNS, Path(scratch) / "chosen")
        overlay = _try(job, 1, Path(scratch) / "overlay", output="overlay")
    part = 1.0
    if whole.cut:
        # sqlite3 files are copied as a whole, but their size is that of what is read
        read = whole.read_bytes if whole.copied else whole.bytes
        part = min(1.0, read / size)
    copied = whole.copied and job.batch.output == "full"
    return Estimate(size if copied else round(chosen.bytes / part), chosen.seconds / part, round(overlay.bytes / part))


@dataclass(frozen=True, slots=True)
class _Trial:
    bytes: float
    seconds: float
    read_bytes: int
    cut: bool
    copied: bool


def _try(job: Job, runs: int, directory: Path, **changes: Any) -> _Trial:
    (directory / PARTS).mkdir(parents=True)
    tried = replace(job, batch=replace(job.batch, **changes), directory=directory)
    firsts: list[_First] = []

    def first(reader: BagReader) -> Any:
        firsts.append(_First(reader))
        return firsts[-1]

    begun = time.process_time()
    make(Task(tried, tuple(range(runs))), first)
    spent = time.process_time() - begun
    written = sum(bytes_of(tried.path_of(run)) for run in range(runs))
    last = firsts[-1]
    return _Trial(written / runs, spent / runs, last.read_bytes, last.cut, last.kind == "sqlite3")


def need_of(jobs: Sequence[Job], runs: range, shard: Shard) -> Need:
    """Return the cost of a batch's missing runs."""
    needs = [(count_missing(job, runs, shard), estimate(job)) for job in jobs]
    size, overlay = sum(n * each.bytes for n, each in needs), sum(n * each.overlay_bytes for n, each in needs)
    seconds = sum((n * each.seconds for n, each in needs), 0.0)
    return Need(sum(n for n, _ in needs), size, seconds, overlay, free_bytes(jobs[0].directory))


def require_space(jobs: Sequence[Job], runs: range, shard: Shard) -> None:
    """Raise BatchError if the disk cannot hold a batch; sizes are measured only if space may be short."""
    if 5 * len(runs) * sum(bytes_of(job.source) for job in jobs) <= free_bytes(jobs[0].directory):
        return
    need = need_of(jobs, runs, shard)
    if need.bytes > need.free_bytes:
        less = f"--output overlay would need {need.overlay_bytes / 1e9:.3g} GB, or " * (need.overlay_bytes < need.bytes)
        raise BatchError(
            f"{jobs[0].shown_directory}: {need.runs} runs need about {need.bytes / 1e9:.3g} GB, "
            f"{need.free_bytes / 1e9:.3g} GB are free; {less}name a directory on another disk"
        )


def free_bytes(directory: Path) -> int:
    """Return the free bytes of a directory's file system; the directory need not exist yet."""
    there = next(one for one in (directory, *directory.parents) if one.exists())
    return shutil.disk_usage(there).free

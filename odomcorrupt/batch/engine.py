"""Who does the work: this process, a pool of processes, or the workers of a Dask cluster. The bytes are the same."""

from __future__ import annotations

import importlib
import multiprocessing
import signal
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import TYPE_CHECKING, Any

from odomcorrupt.batch.book import BatchError, read_records, sweep_leftovers
from odomcorrupt.batch.job import Task
from odomcorrupt.batch.make import attempt

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.batch.job import Job
    from odomcorrupt.batch.make import Failure

__all__ = ["Shard", "missing_runs", "run_local", "run_on_dask", "tasks_of"]

GROUP = 32
"""Runs of one pass at most: each holds an open file and a path of its own."""

LARGE_BYTES = 2 << 30
"""Of larger bags half as many: what a kill interrupts is made again."""

RESTARTS = 3
"""How often a pool whose worker died is begun anew."""


class Shard:
    """Every count-th run, from the number-th on, counted from 1: what one of `count` machines makes."""

    __slots__ = ("count", "number")

    def __init__(self, number: int, count: int) -> None:
        self.number = number
        self.count = count

    def has(self, run: int) -> bool:
        """Whether a run is one of this shard's."""
        return run % self.count == self.number - 1


def missing_runs(job: Job, runs: range, shard: Shard) -> list[int]:
    """Return the runs of a shard that are not made yet, leftovers of earlier attempts removed."""
    own = [run for run in runs if shard.has(run)]
    made = read_records(job.directory)
    missing = [run for run in own if run not in made]
    sweep_leftovers(job, missing)
    return missing


def tasks_of(job: Job, runs: Sequence[int], workers: int) -> list[Task]:
    """Cut runs into passes, so that every worker has some and none has too many at once."""
    size = (
        sum(file.stat().st_size for file in job.source.iterdir()) if job.source.is_dir() else job.source.stat().st_size
    )
    most = GROUP // 2 if size > LARGE_BYTES else GROUP
    group = max(1, min(most, -(-len(runs) // workers)))
    return [Task(job, tuple(runs[i : i + group])) for i in range(0, len(runs), group)]


def run_local(tasks: Sequence[Task], jobs: int, told: Callable[[Task, list[Failure]], None]) -> None:
    """Make tasks in this process, or in `jobs` others; `told` hears of each."""
    if jobs == 1:
        for task in tasks:
            told(task, attempt(task))
        return
    left = dict(enumerate(tasks))
    for _ in range(RESTARTS):
        if not left:
            return
        with ProcessPoolExecutor(jobs, multiprocessing.get_context("spawn"), _unwind_when_killed) as pool:
            futures = {pool.submit(attempt, task): number for number, task in left.items()}
            try:
                for future in as_completed(futures):
                    told(left[futures[future]], future.result())
                    del left[futures[future]]
            except BrokenProcessPool:
                continue
            except BaseException:
                for child in multiprocessing.active_children():
                    child.terminate()
                pool.shutdown(cancel_futures=True)
                raise
    for task in left.values():
        told(task, [(run, "the process that made it died each time") for run in task.runs])


def _unwind_when_killed() -> None:
    signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))


def run_on_dask(job_runs: Sequence[tuple[Job, Sequence[int]]], address: str, told: Any) -> None:
    """Make runs on the workers of a Dask cluster, which see the same files; a task whose worker died goes to another.

    Raises
    ------
    BatchError
        Where dask is not installed, or the scheduler cannot be reached.

    """
    try:
        distributed: Any = importlib.import_module("distributed")  # an optional extra
    except ImportError as error:
        raise BatchError('dask is not installed; --dask needs it: pip install "odomcorrupt[dask]"') from error
    try:
        client = distributed.Client(address, timeout="20s", set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise BatchError(f"{address}: no Dask scheduler answers ({error}); start one with `dask scheduler`") from error
    with client:
        threads = max(1, sum(client.nthreads().values()))
        # four rounds for each: what a lost worker had begun is little
        tasks = [task for job, runs in job_runs for task in tasks_of(job, runs, 4 * threads)]
        futures = {client.submit(attempt, task, pure=False, retries=2): task for task in tasks}
        try:
            for future in distributed.as_completed(futures, loop=client.loop):
                task = futures[future]
                failed = future.exception()
                told(task, future.result() if failed is None else [(run, str(failed)) for run in task.runs])
        except BaseException:
            client.cancel(list(futures))
            raise

"""Execution of a batch: its missing runs, many in one pass over the bag, made here, in a process pool or on Dask."""

from __future__ import annotations

import importlib
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias

import numpy as np

from odomcorrupt.bags.block import Block, ReaderView
from odomcorrupt.bags.open import Form, Target, open_reader
from odomcorrupt.bags.output import beside, place, remove
from odomcorrupt.bags.pipeline import Workers, default_threads
from odomcorrupt.batching.job import Task, drawn_values
from odomcorrupt.batching.manifest import (
    PARTS,
    begin,
    bytes_of,
    content_of,
    fingerprint_of,
    locked,
    note,
    read_records,
    sweep_leftovers,
    write_manifest,
)
from odomcorrupt.batching.patch_batch import LateTopic, SharedRun, portions
from odomcorrupt.batching.sinks import (
    BagSink,
    FullSink,
    MultiSink,
    OverlaySink,
    Rests,
    SplitSink,
    TumSink,
    read_tum,
    write_npz,
)
from odomcorrupt.corruption.inverse import SystematicEffects, changes_nothing
from odomcorrupt.corruption.odometry_source import Frames, localisation_words
from odomcorrupt.corruption.path import MARKS_M
from odomcorrupt.corruption.run import corrupt_bag
from odomcorrupt.corruption.transform import CorrectionEdge, Run, Transform
from odomcorrupt.effects import import_from, imported_from
from odomcorrupt.errors import BatchError, OdomCorruptError
from odomcorrupt.model.model_file import format_model
from odomcorrupt.result_files import write_file

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Message
    from odomcorrupt.batching.job import Job
    from odomcorrupt.batching.patch_batch import Portion
    from odomcorrupt.corruption.path import PathSamples, PathWatcher
    from odomcorrupt.corruption.reorder import Arrivals
    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.forecasting import CleanDrive
    from odomcorrupt.model.motion_model import MotionModel


class MarkMeter:
    """Errors of the last stretch after each of the distances `MARKS_M` and at the end.

    marks : (distance in metres, noisy minus clean x and y in metres, heading in radians)
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Start a new stretch: the stamps have jumped back."""
        self.marks: list[tuple[float, float, float, float]] = []
        self._last: tuple[float, float, float, float] | None = None

    def add(self, samples: PathSamples) -> None:
        """Process the next part of the path."""
        if not len(samples):
            return
        while len(self.marks) < len(MARKS_M) and samples.travelled_m[-1] >= MARKS_M[len(self.marks)]:
            mark_m = MARKS_M[len(self.marks)]
            x, y, turn = samples.error_xyt[np.searchsorted(samples.travelled_m, mark_m)].tolist()
            self.marks.append((mark_m, x, y, turn))
        x, y, turn = samples.error_xyt[-1].tolist()
        self._last = (float(samples.travelled_m[-1]), x, y, turn)

    def result(self) -> list[tuple[float, float, float, float]]:
        """Return the errors at the marks, the last of them at the end."""
        return [*self.marks, *([self._last] if self._last is not None else [])]


class RunState(Run):
    """One run of a batch, over a bag that is read once for many runs; parameters as of `Run`.

    marks : meter of its error along the path
    """

    def __init__(
        self, model: MotionModel, seed: int, run: int, options: Options, watchers: Iterable[PathWatcher] = (),
        **given: Any,
    ) -> None:  # fmt: skip
        self.model, self.number, self.marks = model, run, MarkMeter()
        super().__init__(model, seed, run, options, (self.marks, *watchers), **given)

    def grow(self, parts: Iterable[Arrivals | None]) -> None:
        """Draw the next parts of the path; None marks a restart of time."""
        for part in parts:
            if part is None:
                self.restart()
            else:
                self.extend(part)

    def edges(self, portion: Portion, odom: str) -> list[list[Message]]:
        """Return, for each block of a portion, the transforms with this run's correction."""
        found = []
        for block, targets in zip(portion.blocks, portion.own_targets, strict=True):
            beside = Block(block.data, block.table)
            self.publish(beside, [one for one in targets if one.follows is None], odom)
            found.append(beside.added)
        return found

    def patched(self, portion: Portion) -> NDArray[np.uint8]:
        """Return a portion's data (size,) with this run's correction applied to its targets."""
        block = Block(portion.data.copy(), portion.table)
        self.apply(block, portion.targets, portion.first_ns)
        return block.data


PAUSE_S = 0.3
"""Time between two beats."""


ProgressCallback: TypeAlias = "Callable[[float | None, float], None]"
"""Takes the part of the bag's bytes read, 0 to 1 or None where unknown, and the seconds of recorded time."""


def watched(reader: BagReader, beat: ProgressCallback) -> ReaderView:
    """Return a reader that reports progress."""

    def blocks(only: Container[int] | None) -> Iterator[Block]:
        next_s = time.monotonic() + PAUSE_S
        first_ns: int | None = None
        for block in reader.blocks(only):
            yield block
            if len(block.table):
                first_ns = int(block.table["log_ns"][0]) if first_ns is None else first_ns
            if first_ns is not None and len(block.table) and time.monotonic() >= next_s:
                next_s = time.monotonic() + PAUSE_S
                past_s = (int(block.table["log_ns"][-1]) - first_ns) * 1e-9
                beat(getattr(reader, "part_read", None), past_s)

    return ReaderView(reader, blocks)


CLEAN = "clean.tum"
"""The path without any noise, beside the runs."""

_OVERLAY = Form("mcap", directory=False, ros=None)
"""An overlay holds the messages as the input has them."""

Failure = tuple[int, str]
"""A run, and why it could not be made."""


def attempt(task: Task, beat: ProgressCallback | None = None) -> list[Failure]:
    """Make the runs of a task, after an error each missing run alone; return the failures.

    beat : callback for progress
    """
    try:
        if beat is None:
            make(task)
        else:
            make(task, lambda reader: watched(reader, beat))
    except Exception:  # noqa: BLE001 - an error of one run must not stop the others
        return [failure for run in task.runs if (failure := _alone(task.job, run)) is not None]
    return []


def _alone(job: Job, run: int) -> Failure | None:
    if run in read_records(job.directory):
        return None
    try:
        make(Task(job, (run,)))
    except Exception as error:  # noqa: BLE001 - as above; reported at the end
        said = error.message if isinstance(error, OdomCorruptError) else str(error)
        return run, said or type(error).__name__
    return None


def make(task: Task, part: Callable[[BagReader], Any] = lambda reader: reader) -> None:
    """Make the runs of a task in one pass.

    part : wrapper of the input's reader, such as a limit to its beginning
    """
    whole: set[int] = set()
    while True:
        try:
            _make_staged(task, whole, part)
        except LateTopic as late:
            whole.add(late.channel)
        else:
            return


def _make_staged(task: Task, whole: set[int], part: Callable[[BagReader], Any]) -> None:
    """Make the runs in a hidden folder, record them, and rename them to their final names."""
    job, room = task.job, beside(task.job.directory / "making")
    container = job.batch.container
    try:
        room.mkdir()
        with ExitStack() as stack:
            threads = default_threads() if container.threads is None else container.threads
            workers = stack.enter_context(Workers(threads))
            raw = stack.enter_context(open_reader(job.source, recover=container.recover))
            output = container.target(job.path_of(0), raw) if job.batch.output == "full" else Target(raw, _OVERLAY)
            made = _make(task, room, whole, stack, output, part(output.reader), workers)
        for record, sink in made:
            content = content_of(room / record["file"], None if sink is None else sink.crc)
            record |= {"size": content.size, "crc32": content.crc}
        note(job, [record for record, _ in made])
        for record, _ in made:
            place(room / record["file"], job.directory / record["file"], overwrite=True)
    finally:
        remove(room)


def _make(
    task: Task, room: Path, whole: set[int], stack: ExitStack, output: Target, part: BagReader, workers: Workers
) -> list[tuple[dict[str, Any], BagSink | TumSink | None]]:
    """Make the runs in a folder; return the record of each, and its output, None where the bag is copied unchanged."""
    job = replace(task.job, directory=room)
    home = task.job.directory
    batch = job.batch
    shared = SharedRun(job.model.identity, batch.options)
    transform = Transform(job.model.identity, 0, 0, batch.options, shared=shared)
    transform.odometry.prepare(output.reader, output.reader.name)
    drive = None
    if batch.condition is not None:  # of which runs in a map draw whole paths
        from odomcorrupt.forecasting import clean_drive_of  # noqa: PLC0415 - needed within a map only

        drive = clean_drive_of(job.source, job.model, batch.options, recover=batch.container.recover)
    rests, systematic = Rests(), None if job.spreads else SystematicEffects(job.model)
    runs = [_begin(job, run, output, workers, rests, drive, systematic) for run in task.runs]
    every = list(runs)
    if not (home / CLEAN).exists():
        clean = TumSink(home / CLEAN, None)
        every.append(_Run(RunState(job.model.identity, batch.seed, 0, batch.options, [clean]), clean, patches=False))
    for one in every:
        if one.sink is not None:
            stack.enter_context(one.sink)
    keep, paths = batch.output == "full", batch.output == "trajectories"
    fan: Any = MultiSink([one.sink.writer for one in every if keep and isinstance(one.sink, BagSink)])
    for portion in portions(transform, shared, part, keep=keep, whole=None if keep or paths else whole, writer=fan):
        for one in every:
            one.state.grow(portion.growth)
            data = one.state.patched(portion) if one.patches and portion.targets else portion.data
            if one.sink is not None:
                frames = transform.odometry.frames if one.state.edge is not None else None
                one.sink.write(portion, data, None if frames is None else one.state.edges(portion, frames.odom))
    transform.require_source()
    for one in runs:
        _put_beside(job, home, one)
    frames = transform.odometry.frames or Frames("", None)
    said = localisation_words(transform.stayed, frames, part.channels.values()) if keep else []
    return [(_record(job, one.state, frames.odom, said, part.losses), one.sink) for one in runs]


@dataclass(frozen=True, slots=True)
class _Run:
    """A run being made; its sink is None where the bag is copied unchanged."""

    state: RunState
    sink: BagSink | TumSink | None
    patches: bool


def _begin(
    job: Job, run: int, output: Target, workers: Workers, rests: Rests, drive: CleanDrive | None, systematic:
    SystematicEffects | None,
) -> _Run:  # fmt: skip
    model, batch = job.model_of(run), job.batch
    within = None if batch.condition is None else batch.condition.path(model, batch.seed, run, drive)
    tum = TumSink(job.path_of(run), model) if batch.output == "trajectories" else None
    watchers = [] if tum is None else [tum]
    state = RunState(model, batch.seed, run, batch.options, watchers, path=within, systematic=systematic)
    if tum is not None:
        return _Run(state, tum, patches=False)
    if batch.output == "overlay":
        return _Run(state, OverlaySink(job, run, output.reader), patches=True)
    if batch.also or (changes_nothing(model) and not batch.options.degrades):  # written by itself, or the file copied
        return _Run(state, None, patches=False)
    sink: BagSink = SplitSink(job, run, output, rests) if batch.split else FullSink(job, run, output, workers)
    if batch.options.new_odom_frame is not None:
        state.edge = CorrectionEdge(batch.options.new_odom_frame, output.reader, sink.writer)
    return _Run(state, sink, patches=True)


def _put_beside(job: Job, home: Path, one: _Run) -> None:
    """Write a copy of the bag where nothing changes, and the model file of a run with drawn parameters."""
    run, model = one.state.number, one.state.model
    if one.sink is None:
        batch = job.batch
        container = replace(batch.container, overwrite=True)
        corrupt_bag(
            job.source, job.path_of(run), model, seed=batch.seed, run=run, options=batch.options, container=container,
            also=batch.also,
        )  # fmt: skip
    if job.spreads:
        (home / "robots").mkdir(exist_ok=True)
        write_file(home / job.robot_of(run), format_model(model).encode())


def _record(job: Job, state: RunState, frame: str, *said: Sequence[str]) -> dict[str, Any]:
    drift = state.drift.result()
    assert drift is not None  # noqa: S101 - the transform raises where there was no odometry
    record: dict[str, Any] = {
        "run": state.number,
        "file": job.name_of(state.number),
        "command": job.command_of(state.number),
        "input": job.shown_source,
        "seed": job.batch.seed,
        "odom_frame": frame,
        **{key: list(some) for key, some in zip(("remarks", "losses"), said, strict=True) if some},
    }
    if job.spreads:
        record["robot"] = job.robot_of(state.number)
        record["drawn"] = drawn_values(state.model, job.spreads)
    record["drift"] = {key: value for key, value in drift._asdict().items() if value is not None}
    events = [(one.name, one.window_s) for one in state.model.effects if one.window_s is not None and one.acts]
    if events:
        record["events"] = [{"effect": name, "from_s": w[0], "to_s": w[1]} for name, w in events]
    record["errors"] = [list(np.round(mark, 9).tolist()) for mark in state.marks.result()]
    return record


TRIED_BYTES = 32 << 20
"""How much of a bag is tried, decompressed."""


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


def estimate(job: Job) -> Estimate:
    """Return the cost of one run, from a few runs on the beginning of the bag in a temporary directory."""
    size = bytes_of(job.source)
    with tempfile.TemporaryDirectory() as scratch:
        plain = replace(job.batch.container, compression=None, level=None)
        whole = _try(job, 1, Path(scratch) / "full", output="full", container=plain, split=False)
        chosen = _try(job, 4, Path(scratch) / "chosen")
        overlay = _try(job, 1, Path(scratch) / "overlay", output="overlay")
    part = 1.0
    if whole.cut:
        # sqlite3 files are copied as a whole, but their size is that of what is read
        read = whole.read_bytes if whole.copied else whole.bytes
        part = min(1.0, read / size)
    copied = whole.copied and job.batch.output == "full"
    return Estimate(size if copied else round(chosen.bytes / part), chosen.seconds / part, round(overlay.bytes / part))


@dataclass(slots=True)
class _Trial:
    bytes: float = 0.0
    seconds: float = 0.0
    read_bytes: int = 0
    cut: bool = False
    copied: bool = False


def _try(job: Job, runs: int, directory: Path, **changes: Any) -> _Trial:
    (directory / PARTS).mkdir(parents=True)
    tried = replace(job, batch=replace(job.batch, **changes), directory=directory)
    trial = _Trial()

    def first(reader: BagReader) -> ReaderView:
        """Return a reader of the blocks until `TRIED_BYTES`."""
        trial.copied, trial.cut = reader.kind == "sqlite3", False

        def blocks(_only: Container[int] | None) -> Iterator[Block]:
            trial.read_bytes = 0
            for block in reader.blocks():
                trial.read_bytes += block.data.size
                yield block
                if trial.read_bytes >= TRIED_BYTES:
                    trial.cut = True
                    return

        return ReaderView(reader, blocks)

    begun = time.process_time()
    make(Task(tried, tuple(range(runs))), first)
    trial.seconds = (time.process_time() - begun) / runs
    trial.bytes = sum(bytes_of(tried.path_of(run)) for run in range(runs)) / runs
    return trial


def need_of(jobs: Sequence[Job], runs: range, shard: Shard) -> Need:
    """Return the cost of a batch's missing runs."""
    made = [sum(run in runs and shard.has(run) for run in read_records(job.directory)) for job in jobs]
    of_shard = len(runs[shard.number - 1 :: shard.count])
    needs = [(of_shard - own, estimate(job)) for own, job in zip(made, jobs, strict=True)]
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


GROUP = 32
"""Runs of one pass at most: each holds an open file and a path of its own."""

LARGE_BYTES = 2 << 30
"""Of larger bags half as many: what a kill interrupts is made again."""


@dataclass(frozen=True, slots=True)
class Shard:
    """One machine's part of a batch: every count-th run from the number-th on, counted from 1."""

    number: int = 1
    count: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.number <= self.count:
            raise BatchError(f"shard: {self.number} of {self.count}; count the parts from 1")

    def has(self, run: int) -> bool:
        """Whether a run belongs to this shard."""
        return run % self.count == self.number - 1


ALL = Shard()
"""All runs, of a batch on one machine."""


def missing_runs(job: Job, runs: range, shard: Shard, *, verify: bool = False) -> list[int]:
    """Return the runs of a shard that are not made yet, leftovers of earlier attempts removed.

    verify : whether a run counts as made only if its checksum is the recorded one, too
    """
    made = read_records(job.directory, verify=verify)
    missing = [run for run in runs if shard.has(run) and run not in made]
    sweep_leftovers(job, missing)
    return missing


def tasks_of(job: Job, runs: Sequence[int], workers: int) -> list[Task]:
    """Divide runs into passes over the bag, at least one for each worker where possible and of limited size."""
    most = GROUP // 2 if bytes_of(job.source) > LARGE_BYTES else GROUP
    group = max(1, min(most, -(-len(runs) // workers)))
    return [Task(job, tuple(runs[i : i + group])) for i in range(0, len(runs), group)]


class Audience(Protocol):
    """Callbacks for the progress of tasks.

    shown : whether progress within a task is displayed
    failures : failures of the tasks that are done
    """

    shown: bool
    failures: list[Failure]

    def done(self, task: Task, failures: list[Failure]) -> None:  # noqa: ARG002 - for those who show it
        """Report that a task is done."""
        self.failures.extend(failures)

    def under_way(self, task: Task, part: float | None, past_s: float) -> None:  # noqa: ARG002 - as above
        """Report the part of the bag read by a task's pass, 0 to 1, and its seconds; only if `shown`."""
        return


@dataclass(slots=True)
class _Silent(Audience):
    """Audience that only collects the failures."""

    shown: bool = False
    failures: list[Failure] = field(default_factory=list)


def run_local(tasks: Sequence[Task], jobs: int, audience: Audience) -> None:
    """Run tasks in this process, or in `jobs` worker processes.

    tasks : passes over bags
    jobs : number of processes; 1 for this process alone
    audience : receives runs that are made or failed, and progress
    """
    if jobs == 1:
        for task in tasks:
            audience.done(task, attempt(task, partial(audience.under_way, task) if audience.shown else None))
        return
    left = dict(enumerate(tasks))
    # maximum number of restarts of a pool whose worker died
    for _ in range(3):
        if left:
            _run_in_pool(left, jobs, audience)
    for task in left.values():
        audience.done(task, [(run, "the process that made it died each time") for run in task.runs])


def _run_in_pool(left: dict[int, Task], jobs: int, audience: Audience) -> None:
    """Run tasks in a process pool and remove finished ones from `left`; a worker that dies ends the pool."""
    import multiprocessing  # noqa: PLC0415 - slow to import, and not needed for one process
    from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait  # noqa: PLC0415 - as above
    from concurrent.futures.process import BrokenProcessPool  # noqa: PLC0415 - as above

    context = multiprocessing.get_context("fork" if _single_threaded() else "spawn")
    news = context.Queue() if audience.shown else None
    with ProcessPoolExecutor(jobs, context, _prepare_worker, (news, imported_from)) as pool:
        try:  # a worker that cannot be started leaves others that wait
            # a worker that just starts has the handler of this process, whose exception the pool would print
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGTERM})
            try:
                futures = {pool.submit(_attempt_numbered, number, task): number for number, task in left.items()}
            finally:
                signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
            waiting = set(futures)
            while waiting:
                ready, waiting = wait(waiting, PAUSE_S if news is not None else None, FIRST_COMPLETED)
                while news is not None and not news.empty():
                    number, part, past_s = news.get()
                    if number in left:
                        audience.under_way(left[number], part, past_s)
                for future in ready:
                    audience.done(left[futures[future]], future.result())
                    del left[futures[future]]
        except BrokenProcessPool:
            return
        except BaseException:
            for child in multiprocessing.active_children():
                while child.is_alive():  # one that is just starting may lose the first signal
                    child.terminate()
                    child.join(PAUSE_S)
            pool.shutdown(cancel_futures=True)
            raise


def _single_threaded() -> bool:
    """Whether this process has no thread but one: its copy then is whole, and need not start Python again."""
    tasks = Path("/proc/self/task")  # of Linux only
    return tasks.is_dir() and len([*tasks.iterdir()]) == 1


_news: Any = None
"""In a worker: queue for progress messages; None without a listener."""


def _prepare_worker(news: Any, folders: Mapping[str, str]) -> None:
    global _news  # noqa: PLW0603 - a worker's own, set once
    signal.signal(signal.SIGTERM, signal.SIG_DFL)  # the pool would print an exception raised here
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGTERM})
    _news = news
    for name, folder in folders.items():
        if name not in sys.modules:
            import_from(name, folder)
    if news is not None:
        # unread progress messages must not keep a worker alive
        news.cancel_join_thread()
    # an interrupt reaches all processes of a terminal: the parent passes it on, once
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _terminated(number: int, _frame: object) -> None:
    """End this worker, its files removed; no second signal interrupts that."""
    signal.signal(number, signal.SIG_IGN)
    sys.exit(128 + number)


def _end_with_parent() -> None:
    """End this worker when the batch process dies; otherwise it would wait for ever and hold the batch's lock."""
    import multiprocessing  # noqa: PLC0415 - as above

    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        signal.pthread_kill(threading.main_thread().ident or 0, signal.SIGTERM)
        # time in which a worker whose batch is dead removes its files
        time.sleep(5.0)
        os._exit(1)


def _attempt_numbered(number: int, task: Task) -> list[Failure]:
    """Run a task in a worker."""
    try:
        signal.signal(signal.SIGTERM, _terminated)
        return attempt(task, None if _news is None else lambda part, past_s: _news.put((number, part, past_s)))
    except SystemExit as ended:  # the pool would send it to the batch as an answer
        os._exit(int(ended.code or 0))


def run_on_dask(job_runs: Sequence[tuple[Job, Sequence[int]]], address: str, audience: Audience) -> None:
    """Run tasks on a Dask cluster with access to the same files; a task whose worker died is repeated on another.

    job_runs : jobs with the runs to make
    address : of the scheduler, such as "tcp://host:8786"
    audience : receives runs that are made or failed

    Raises
    ------
    BatchError
        If dask is not installed, or the scheduler cannot be reached.
    """
    try:
        distributed: Any = importlib.import_module("distributed")  # an optional extra
    except ImportError as error:
        raise BatchError(
            'dask is not installed; --dask needs it: in a copy of the repository, pip install ".[dask]"'
        ) from error
    try:
        client = distributed.Client(address, timeout="20s", set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise BatchError(f"{address}: no Dask scheduler answers ({error}); start one with `dask scheduler`") from error
    with client:
        threads = max(1, sum(client.nthreads().values()))
        # four tasks for each worker: little is lost with one
        tasks = [task for job, runs in job_runs for task in tasks_of(job, runs, 4 * threads)]
        futures = {client.submit(attempt, task, pure=False, retries=2): task for task in tasks}
        try:
            for future in distributed.as_completed(futures, loop=client.loop):
                task = futures[future]
                failed = future.exception()
                audience.done(task, future.result() if failed is None else [(run, str(failed)) for run in task.runs])
        except BaseException:
            client.cancel(list(futures))
            raise


def require_odometry(jobs: Sequence[Job]) -> None:
    """Raise an error at once where all runs would fail: no odometry or topic to leave out, or an invalid model."""
    for job in jobs:
        options = job.batch.options
        robots = [options._replace(odom_topic=topic, odom_frame=None, base_frame=None) for topic in job.batch.also]
        with open_reader(job.source, recover=job.batch.container.recover) as reader:
            for own in (options, *robots):
                transform = Transform(job.model_of(0), job.batch.seed, 0, own)
                transform.odometry.prepare(reader, reader.name)
                if options.consistent:
                    transform.relations(reader)
            if job.batch.output == "full":
                job.batch.container.target(job.path_of(0), reader)


@dataclass(frozen=True, slots=True)
class Made:
    """Result of a batch call: number of runs made, and failed runs with their reasons."""

    runs: int
    failures: tuple[Failure, ...]


def run_batch(
    jobs: Sequence[Job], runs: range, *, processes: int = 1, shard: Shard = ALL, verify: bool = False, dask: str | None
    = None, audience: Audience | None = None,
) -> Made:  # fmt: skip
    """Make the missing runs of jobs and their manifests; return the number made and the failures.

    jobs, runs : jobs, and the numbers of their runs
    processes : number of processes
    shard : part of the runs to make, where several machines share them
    verify : whether runs whose checksums differ from their records are made again
    dask : address of a Dask scheduler
    audience : callbacks for progress

    Raises
    ------
    BatchError
        If a directory contains another batch.
    """
    require_odometry(jobs)
    fingerprints = {source: fingerprint_of(source) for source in {job.source for job in jobs}}
    for job in jobs:
        begin(job, fingerprints[job.source])
    audience = audience or _Silent()
    with ExitStack() as locks:
        for job in jobs:
            locks.enter_context(locked(job, shared=shard.count > 1))
        todo = [(job, missing_runs(job, runs, shard, verify=verify)) for job in jobs]
        if dask is not None:
            run_on_dask(todo, dask, audience)
        else:
            run_local([task for job, own in todo for task in tasks_of(job, own, processes)], processes, audience)
        for job in jobs:
            write_manifest(job.directory)
            made = read_records(job.directory) if job.batch.output == "trajectories" else {}
            if made and set(runs) <= made.keys():  # all paths exist
                files = [job.directory / record["file"] for record in made.values()]
                write_npz(job.directory / "trajectories.npz", read_tum(job.directory / CLEAN), list(made), files)
    return Made(sum(len(own) for _, own in todo) - len(audience.failures), tuple(audience.failures))

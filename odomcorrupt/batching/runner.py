"""Runs of a batch in one pass over the bag: read once, patched and written for each run."""

from __future__ import annotations

import time
from contextlib import ExitStack
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from odomcorrupt.bags.block import Block, ReaderView
from odomcorrupt.bags.open import Form, Target, open_reader
from odomcorrupt.bags.output import beside, place, remove
from odomcorrupt.bags.pipeline import Workers, default_threads
from odomcorrupt.batching.job import Task
from odomcorrupt.batching.manifest import content_of, note, read_records
from odomcorrupt.batching.parameter_draws import drawn_values
from odomcorrupt.batching.patch_batch import LateTopic, SharedRun, portions
from odomcorrupt.batching.sinks import BagSink, FullSink, MultiSink, OverlaySink, TumSink
from odomcorrupt.corruption.inverse import SystematicEffects, changes_nothing
from odomcorrupt.corruption.odometry_source import Frames, localisation_words
from odomcorrupt.corruption.path import MARKS_M
from odomcorrupt.corruption.run import corrupt_bag
from odomcorrupt.corruption.transform import CorrectionEdge, Run, Transform
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.model.model_file import format_model
from odomcorrupt.result_files import write_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Iterator, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Message
    from odomcorrupt.batching.job import Job
    from odomcorrupt.batching.patch_batch import Portion
    from odomcorrupt.corruption.path import PathSamples, PathWatcher
    from odomcorrupt.corruption.reorder import Arrivals
    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.forecasting.forecast import CleanDrive
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
            self.marks.append((mark_m, *_error(samples, int(np.searchsorted(samples.travelled_m, mark_m)))))
        self._last = (float(samples.travelled_m[-1]), *_error(samples, len(samples) - 1))

    def result(self) -> list[tuple[float, float, float, float]]:
        """Return the errors at the marks, the last of them at the end."""
        return [*self.marks, *([self._last] if self._last is not None else [])]


def _error(samples: PathSamples, i: int) -> tuple[float, float, float]:
    x, y, turn = samples.error_xyt[i].tolist()
    return x, y, turn


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


class Watched(ReaderView):
    """A reader that reports progress."""

    def __init__(self, reader: BagReader, beat: ProgressCallback) -> None:
        super().__init__(reader)
        self._beat = beat

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
            make(task, lambda reader: Watched(reader, beat))
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
    sink, drive = _sinks(job, output, workers), _drive(job)
    systematic = None if job.spreads else SystematicEffects(job.model)
    runs = [_begin(job, run, output, sink, drive, systematic) for run in task.runs]
    every = list(runs)
    if not (home / CLEAN).exists():
        clean = TumSink(home / CLEAN, None)
        every.append(_Run(RunState(job.model.identity, batch.seed, 0, batch.options, [clean]), clean, patches=False))
    for one in every:
        if one.sink is not None:
            stack.enter_context(one.sink)
    keep, paths = batch.output == "full", batch.output == "trajectories"
    writers = [one.sink.writer for one in every if keep and isinstance(one.sink, BagSink)]
    fan: Any = MultiSink(writers)
    whole_topics = None if keep or paths else whole
    for portion in portions(transform, shared, part, keep=keep, whole=whole_topics, writer=fan):
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


def _drive(job: Job) -> CleanDrive | None:
    """Return the odometry of the bag, of which runs in a map draw whole paths; None without a map."""
    if job.batch.condition is None:
        return None
    from odomcorrupt.forecasting.forecast import clean_drive_of  # noqa: PLC0415 - needed within a map only

    return clean_drive_of(job.source, job.model, job.batch.options, recover=job.batch.container.recover)


def _sinks(job: Job, output: Target, workers: Workers) -> Callable[[int], BagSink]:
    """Return the function that creates the output of a run, for runs that are bags."""
    if job.batch.output == "overlay":
        return lambda run: OverlaySink(job, run, output.reader)
    if not job.batch.split:
        return lambda run: FullSink(job, run, output, workers)
    from odomcorrupt.batching.split_layout import Rests, SplitSink  # noqa: PLC0415 - seldom needed

    rests = Rests()
    return lambda run: SplitSink(job, run, output, rests)


def _begin(
    job: Job, run: int, output: Target, sink_of: Callable[[int], BagSink], drive: CleanDrive | None, systematic:
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
        return _Run(state, sink_of(run), patches=True)
    if batch.also or (changes_nothing(model) and not batch.options.degrades):  # written by itself, or the file copied
        return _Run(state, None, patches=False)
    sink = sink_of(run)
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
        write_bytes(home / job.robot_of(run), format_model(model).encode())


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

"""The jobs of a batch, one directory for each input and each point of a sweep, and their execution."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from odomcorrupt.bags.open import open_reader
from odomcorrupt.batching.engine import Shard, missing_runs, run_local, run_on_dask, tasks_of
from odomcorrupt.batching.job import Job
from odomcorrupt.batching.manifest import (
    BatchError,
    begin,
    fingerprint_of,
    locked,
    read_beginning,
    read_records,
    write_manifest,
)
from odomcorrupt.batching.parameter_draws import spreads_of, stated_spreads
from odomcorrupt.batching.sinks import read_tum, write_npz
from odomcorrupt.batching.sweep import variants
from odomcorrupt.corruption.run import Container
from odomcorrupt.corruption.transform import Options, Transform
from odomcorrupt.model.model_file import format_model, parse_model, read_model_text
from odomcorrupt.rng import draw_seed

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from odomcorrupt.batching.engine import Audience
    from odomcorrupt.batching.job import Output, Task
    from odomcorrupt.batching.runner import Failure
    from odomcorrupt.mapping.map_condition import MapCondition
    from odomcorrupt.model.motion_model import MotionModel


@dataclass(frozen=True, slots=True, kw_only=True)
class BatchSpec:
    """Configuration of a batch.

    model : model of all runs
    seed : seed of all draws
    model_file : file of the model, whose parameters "a +- b" are drawn for each run
    posterior : whether all parameters with a standard error are drawn
    sweeps : such as "alpha-scale=0.5,1,2"
    points : number of Sobol points in the ranges of the sweeps
    options, container : options of corruption, and of reading and writing
    output : whole bags, changed topics only, or paths
    split : whether changed messages are written in chunks of their own
    condition : map to which every run is constrained
    suffix : of the names of whole bags, which says what they become; None: that of the input
    model_words : command-line arguments for the model of a single run; None: the directory's model.toml
    map_words : command-line arguments for the map
    """

    model: MotionModel
    seed: int
    model_file: Path | None = None
    posterior: bool = False
    sweeps: tuple[str, ...] = ()
    points: int = 0
    options: Options = field(default_factory=Options)
    container: Container = field(default_factory=Container)
    output: Output = "full"
    split: bool = False
    condition: MapCondition | None = None
    suffix: str | None = None
    model_words: tuple[str, ...] | None = None
    map_words: tuple[str, ...] = ()


def plan(inputs: Sequence[Path], target: Path, spec: BatchSpec) -> list[Job]:
    """Return the jobs of a batch in the directory `target`.

    Parameters
    ----------
    inputs : sequence of Path
        Bags.
    target : Path
        Directory of the batch.
    spec : BatchSpec
        Model, seed, sweeps, options and kind of output.

    Returns
    -------
    list of Job
        One for each input and each point of a sweep.

    Raises
    ------
    BatchError
        If inputs would share a directory, or do not support the requested output.
    """
    stems = [source.stem for source in inputs]
    if len(set(stems)) < len(stems):
        twice = next(stem for stem in stems if stems.count(stem) > 1)
        raise BatchError(f"inputs: two of them are called {twice}, and would share a directory; rename one")
    if spec.posterior and not spec.model.standard_errors:
        raise BatchError("--robots posterior: the model has no standard errors; give the --model that a fit wrote")
    stated = frozenset[str]() if spec.model_file is None else stated_spreads(spec.model_file)
    jobs = []
    for source in inputs:
        if source.is_dir() and target.resolve().is_relative_to(source.resolve()):
            raise BatchError(f"{target}: lies in the input {source}, which stays as it is; name a directory elsewhere")
        if spec.split:
            _require_chunks(source, spec)
        for variant in variants(spec.model, spec.sweeps, spec.points):
            parts = ([source.stem] if len(inputs) > 1 else []) + ([variant.name] if variant.name else [])
            directory = target.joinpath(*parts)
            by_file = ("--model", f"{directory}/model.toml")
            model, text = variant.model, format_model(variant.model)
            words: tuple[str, ...] = by_file
            if not variant.name and spec.model_file is not None:
                # the file as it is now: it may be edited later
                text, words = read_model_text(spec.model_file), (*by_file, *(spec.model_words or ()))
            elif not variant.name and spec.model_words is not None:
                words = spec.model_words
            elif not variant.name:
                # a single run reads the file, which has nine digits
                model = parse_model(text)
            jobs.append(
                Job(
                    source=source.absolute(),
                    directory=directory.absolute(),
                    model=model,
                    spreads=spreads_of(model, None if spec.posterior else stated),
                    seed=spec.seed,
                    options=spec.options,
                    container=spec.container,
                    output=spec.output,
                    split=spec.split,
                    model_text=text,
                    model_words=words,
                    option_words=(*_option_words(spec.options, spec.container), *spec.map_words),
                    shown_source=str(source),
                    shown_directory=str(directory),
                    condition=spec.condition,
                    suffix=spec.suffix,
                )
            )
    return jobs


def _require_chunks(source: Path, spec: BatchSpec) -> None:
    """Raise BatchError for runs that do not have the chunks of the input, which alone can be split."""
    with open_reader(source, recover=spec.container.recover) as reader:
        if reader.kind == "sqlite3":
            raise BatchError(
                f"{source}: sqlite3 has no chunks for --layout split to divide, and is not recompressed; "
                "leave --layout out"
            )
        modes = {getattr(reader, "mode", "none"), spec.container.compression}
    c = spec.container
    if spec.suffix is not None or c.exclude or c.ros or c.storage or not modes.isdisjoint(("file", "message")):
        raise BatchError(
            f"{source}: --layout split needs the chunks of the input, and these runs are written in another way; leave "
            "--layout out"
        )


def _drift_words(options: Options) -> str | None:
    if options.new_odom_frame is None:
        return None
    return "subtraction" if options.subtracted else "correction"


def _option_words(options: Options, container: Container) -> list[str]:
    """Return the command-line arguments for frames, topics and containers."""
    values = (
        ("--odom-topic", options.odom_topic),
        ("--odom-frame", options.odom_frame),
        ("--base-frame", options.base_frame),
        ("--twist", "keep" if options.keep_twist else None),
        ("--covariance", "keep" if options.keep_covariance else None),
        ("--keep-truth", options.keep_truth),
        ("--tf", _drift_words(options)),
        ("--new-odom-frame", options.new_odom_frame),
        ("--compression", container.compression),
        ("--level", container.level),
        ("--ros", container.ros),
        ("--storage", container.storage),
        *(("--exclude-topic", topic) for topic in container.exclude),
    )
    words = [word for flag, value in values if value is not None for word in (flag, str(value))]
    return words + ["--keep-localisation"] * options.keep_localisation + ["--recover"] * container.recover


def seed_of(directory: Path) -> int:
    """Return the seed of the batch in a directory, or a new one."""
    there = next(iter(sorted(directory.rglob("batch.json"))), None)
    return draw_seed() if there is None else int(read_beginning(there.parent)["seed"])


def require_odometry(jobs: Sequence[Job]) -> None:
    """Raise an error at once where all runs would fail: no odometry, or an invalid model."""
    for job in jobs:
        with open_reader(job.source, recover=job.container.recover) as reader:
            Transform(job.model_of(0), job.seed, 0, job.options).odometry.prepare(reader, reader.name)


@dataclass(frozen=True, slots=True)
class Made:
    """Result of a batch call: number of runs made, and failed runs with their reasons."""

    runs: int
    failures: tuple[Failure, ...]


class _Counter:
    """Collects failures, and forwards progress."""

    def __init__(self, audience: Audience | None) -> None:
        self._audience = audience
        self.shown = audience is not None and audience.shown
        self.failures: list[Failure] = []

    def done(self, task: Task, failures: list[Failure]) -> None:
        self.failures.extend(failures)
        if self._audience is not None:
            self._audience.done(task, failures)

    def under_way(self, task: Task, part: float | None, past_s: float) -> None:
        if self._audience is not None:
            self._audience.under_way(task, part, past_s)


def run_batch(
    jobs: Sequence[Job],
    runs: range,
    *,
    processes: int = 1,
    shard: Shard | None = None,
    verify: bool = False,
    dask: str | None = None,
    audience: Audience | None = None,
) -> Made:
    """Make the missing runs of jobs and their manifests; return the number made and the failures.

    Parameters
    ----------
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
    part = shard or Shard(1, 1)
    counter = _Counter(audience)
    with ExitStack() as locks:
        for job in jobs:
            locks.enter_context(locked(job, shared=part.count > 1))
        todo = [(job, missing_runs(job, runs, part, verify=verify)) for job in jobs]
        if dask is not None:
            run_on_dask(todo, dask, counter)
        else:
            run_local([task for job, own in todo for task in tasks_of(job, own, processes)], processes, counter)
        for job in jobs:
            write_manifest(job.directory)
            _collect(job, runs)
    return Made(sum(len(own) for _, own in todo) - len(counter.failures), tuple(counter.failures))


def _collect(job: Job, runs: range) -> None:
    """Write all paths to one file, once all of them exist."""
    if job.output == "trajectories":
        made = read_records(job.directory)
        if set(runs) <= made.keys():
            files = [job.directory / record["file"] for record in made.values()]
            write_npz(job.directory / "trajectories.npz", read_tum(job.directory / "clean.tum"), list(made), files)

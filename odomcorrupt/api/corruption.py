"""Bags corrupted, one or many, and measured odometry corrected."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict, dataclass, fields
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, Unpack

from odomcorrupt.api.model import Model, as_model
from odomcorrupt.api.recordings import as_paths
from odomcorrupt.api.result import Result
from odomcorrupt.errors import OdomCorruptError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from matplotlib.figure import Figure

    from odomcorrupt.api.model import ModelLike
    from odomcorrupt.api.recordings import PathLikes
    from odomcorrupt.bags.block import Block
    from odomcorrupt.bags.convert.message_types import Generation
    from odomcorrupt.batching.job import Job
    from odomcorrupt.batching.runner import Failure
    from odomcorrupt.correction.run import Corrected
    from odomcorrupt.corruption.drift import Drift
    from odomcorrupt.corruption.run import Container, Outcome
    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.mapping.map_condition import MapCondition
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.preview.forecast import CleanDrive
    from odomcorrupt.report.text.summary import Summary

__all__ = [
    "BagOptions",
    "Batch",
    "Correction",
    "Corruption",
    "batch",
    "correct",
    "corrupt",
    "options_of",
    "split_options",
]


class BagOptions(TypedDict, total=False):
    """What of a bag is moved, and how it is written.

    odom_topic : the odometry that drives the model; by default the only one
    odom_frame, base_frame : frames, where the odometry's own are not those of TF
    keep_twist, keep_covariance : leave twists or covariances as they are
    keep_truth : a topic on which the clean odometry stays
    keep_localisation : move map -> odom the other way, so that map -> base stays true
    new_odom_frame : leave everything alone and publish the drift as the transform from this frame to odom
    subtracted : publish noisy minus clean there, component by component, as the article's listing does
    overwrite : replace an existing output
    compression, level : of the output: none, lz4, zstd (MCAP), bz2 (ROS 1), file, message (directories of ROS 2);
        by default those of the input
    ros : 1 or 2, the generation of ROS of the output's messages, where its name leaves a choice
    storage : mcap or sqlite3, of an output that is a directory
    exclude : topics left out of the output
    recover : read what is whole of a damaged input
    threads : that read, compute and compress side by side; by default one a core, at most four
    """

    odom_topic: str | None
    odom_frame: str | None
    base_frame: str | None
    keep_twist: bool
    keep_covariance: bool
    keep_truth: str | None
    keep_localisation: bool
    new_odom_frame: str | None
    subtracted: bool
    overwrite: bool
    compression: str | None
    level: int | None
    ros: Generation | None
    storage: str | None
    exclude: tuple[str, ...]
    recover: bool
    threads: int | None


def split_options(options: BagOptions) -> tuple[Options, Container]:
    """Return what is moved, and how bags are read and written."""
    from odomcorrupt.corruption.run import Container
    from odomcorrupt.corruption.transform import Options

    moved = {field.name for field in fields(Options)}
    known = moved | {field.name for field in fields(Container)}
    for name in options:
        if name not in known:
            raise TypeError(f"{name}: no such option; there are {', '.join(sorted(known))}")
    values: dict[str, Any] = dict(options)
    return (
        Options(**{name: value for name, value in values.items() if name in moved}),
        Container(**{name: value for name, value in values.items() if name not in moved}),
    )


def options_of(options: BagOptions) -> Options:
    """Return what is moved, without how bags are written."""
    return split_options(options)[0]


def _path(path: str | PathLike[str]) -> Path | None:
    """Return a path; None for "-", a pipe."""
    return None if fspath(path) == "-" else Path(fspath(path))


@dataclass(frozen=True, slots=True, repr=False)
class Corruption(Result):
    """What corruption did to a bag.

    source, target : the bags; "-" is a pipe
    model : what was drawn from
    outcome : all that is known of the run
    map_account : what a map did to the draws, in a sentence; "" without one
    earlier : what earlier corruptions of the input noted in it: seed, run, version, model
    """

    source: str
    target: str
    model: Model
    outcome: Outcome
    map_account: str = ""
    earlier: tuple[dict[str, str], ...] = ()

    @property
    def seed(self) -> int:
        """Seed of all draws."""
        return self.outcome.seed

    @property
    def run(self) -> int:
        """Number of the run of this seed."""
        return self.outcome.run

    @property
    def drift(self) -> Drift:
        """Errors at the end and per 10 m, as drawn and as the noise is expected to make them; metres and radians."""
        return self.outcome.drift

    @property
    def moved(self) -> dict[str, int]:
        """How many messages were moved on each topic, and how many transforms of each edge "parent -> child"."""
        return {**self.outcome.changes.odometry, **self.outcome.changes.edges}

    @property
    def losses(self) -> tuple[str, ...]:
        """What could not be read of a damaged input, in sentences."""
        return self.outcome.losses

    def summary(self) -> Summary:
        """Return what moved, by which model and seed, the drift at the end, and what is odd."""
        from odomcorrupt.corruption.summary import brief

        return brief(self.outcome, self.model.origin, self.target, [*self._again(), self.map_account])

    def details(self) -> str:
        """Return all of it in one paragraph."""
        from odomcorrupt.corruption.summary import summary

        said = (summary(self.outcome, self.model.origin), self.map_account, *self._again())
        return " ".join(part for part in said if part)

    def _again(self) -> list[str]:
        return [
            f"The input was corrupted before (seed {one.get('seed', '?')}, run {one.get('run', '?')}): drifts add up."
            for one in self.earlier
        ]

    def to_dict(self) -> dict[str, Any]:
        """Return seed, run, model, what was moved, the drift and what is odd as plain values."""
        from odomcorrupt.corruption.summary import oddities
        from odomcorrupt.report.json.numbers import finite

        outcome = self.outcome
        return dict(
            finite(
                {
                    "schema": 2,
                    "input": self.source,
                    "output": self.target,
                    "seed": outcome.seed,
                    "run": outcome.run,
                    "law": outcome.model.noise.law_name,
                    "parameters": self.model.parameters,
                    "odometry": outcome.driver,
                    "odom_frame": outcome.frames.odom,
                    "base_frame": outcome.frames.base,
                    "moved": self.moved,
                    "added": dict(outcome.added),
                    "drift": asdict(outcome.drift),
                    "remarks": oddities(outcome),
                    "losses": list(outcome.losses),
                    "earlier": list(self.earlier),
                }
            )
        )

    def rows(self) -> list[dict[str, Any]]:
        """Return the drift at the end and per 10 m, drawn and expected."""
        d = self.outcome.drift
        rows = [("end", d.end_drawn_m, d.end_drawn_rad, d.end_expected_m, d.end_expected_rad)]
        if d.leg_drawn_m is not None:
            rows.append(
                ("10 m", d.leg_drawn_m, d.leg_drawn_rad or 0.0, d.leg_expected_m or 0.0, d.leg_expected_rad or 0.0)
            )
        names = ("after", "drawn_m", "drawn_rad", "expected_m", "expected_rad")
        return [dict(zip(names, row, strict=True)) for row in rows]

    def _figure(self) -> Figure:
        """Return the clean path and the noisy one, read from the two bags."""
        from odomcorrupt.report.plots.corruption import draw_corruption
        from odomcorrupt.trajectories.reader import read_drive

        if "-" in (self.source, self.target):
            raise OdomCorruptError("a picture of a corruption: reads both bags again, which a pipe cannot give")
        clean, noisy = (read_drive(Path(path), self.outcome.driver) for path in (self.source, self.target))
        return draw_corruption(clean.xyt, noisy.xyt, f"{Path(self.target).name}: seed {self.seed}, run {self.run}")


def corrupt(
    source: str | PathLike[str],
    target: str | PathLike[str],
    *,
    model: ModelLike | None = None,
    seed: int | None = None,
    run: int = 0,
    within: MapCondition | str | PathLike[str] | None = None,
    watch: Callable[[Block], None] = lambda _: None,
    **options: Unpack[BagOptions],
) -> Corruption:
    """Corrupt the odometry of a bag: its poses, twists and covariances, and the TF edges that go with them.

    Parameters
    ----------
    source, target : path
        Bags of any kind; "-" is a pipe. The target appears when it is complete, or not at all.
    model : Model, Noise, path of a model file or name of a preset, optional
        By default the preset `typical`.
    seed : int, optional
        Of all draws: the same seed gives the same bytes. By default one is drawn; the result has it.
    run : int
        Which run of this seed.
    within : MapCondition or path of a map's .yaml, optional
        Draw no pose into a wall, as a particle filter does; the odom frame is then the map's. See
        `odomcorrupt.mapping.map_condition.read_condition` for other robots and frames.
    watch : callable
        Called with every block written.
    **options
        See `BagOptions`.

    Returns
    -------
    Corruption
        What was moved, and how far it drifted.

    Raises
    ------
    BagError, TopicError, EffectError, ModelError, MapError
        Where a bag cannot be read or written, no odometry drives the model, or the model makes no sense.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> noise = oc.Noise(alpha=(0.05, 0.02, 0.05, 0.01))
    >>> done = oc.corrupt("fixtures/office.mcap", "noisy.mcap", model=noise, seed=7, overwrite=True)
    >>> done.seed, done.moved["/odom"]
    (7, 3000)

    """
    from odomcorrupt.bags.provenance import ProvenanceWatcher
    from odomcorrupt.corruption.run import corrupt_bag
    from odomcorrupt.rng import draw_seed

    moved, container = split_options(options)
    chosen = as_model(model)
    drawn = draw_seed() if seed is None else seed
    condition = _condition(within)
    watcher = ProvenanceWatcher(watch)
    with ExitStack() as kept:
        path, bag = None, _path(source)
        if condition is not None:
            bag = _kept_pipe(kept) if bag is None else bag
            drive = _clean_drive(bag, chosen.motion_model, moved, recover=container.recover)
            path = condition.path(chosen.motion_model, drawn, run, drive)
        outcome = corrupt_bag(
            bag,
            _path(target),
            chosen.motion_model,
            seed=drawn,
            run=run,
            options=moved,
            container=container,
            watch=watcher,
            path=path,
            told={} if condition is None else condition.provenance(),
        )
    account = "" if path is None else path.account()
    return Corruption(fspath(source), fspath(target), chosen, outcome, account, watcher.provenance(_path(source)))


def _kept_pipe(kept: ExitStack) -> Path:
    """Return a temporary file with what is on stdin: a path within a map is drawn for the whole drive."""
    import shutil
    import sys
    import tempfile

    from odomcorrupt.errors import BagError

    try:
        file = kept.enter_context(tempfile.NamedTemporaryFile(prefix="odomcorrupt"))  # noqa: SIM115 - it is one
        shutil.copyfileobj(sys.stdin.buffer, file)
        file.flush()
    except OSError as error:
        raise BagError(f"stdin: cannot be kept while it is read: {error.strerror}; name a file") from error
    return Path(file.name)


def _clean_drive(source: Path, model: MotionModel, options: Options, *, recover: bool) -> CleanDrive:
    """Return the odometry of a bag, read before the bag is corrupted."""
    from odomcorrupt.bags.open import open_reader
    from odomcorrupt.preview.forecast import read_clean_drive

    with open_reader(source, recover=recover) as reader:
        return read_clean_drive(reader, model, options)


def _condition(within: MapCondition | str | PathLike[str] | None) -> MapCondition | None:
    if isinstance(within, str | PathLike):
        from odomcorrupt.mapping.map_condition import read_condition

        return read_condition(fspath(within))
    return within


@dataclass(frozen=True, slots=True, repr=False)
class Correction(Result):
    """What correction took out of measured odometry.

    source, target : the bags
    outcome : all that is known of it
    """

    source: str
    target: str
    outcome: Corrected

    @property
    def drift(self) -> Drift:
        """By how much the odometry was moved (drawn), and what the noise is still expected to do (expected)."""
        return self.outcome.drift

    @property
    def losses(self) -> tuple[str, ...]:
        """What could not be read of a damaged input, in sentences."""
        return self.outcome.losses

    def summary(self) -> Summary:
        """Return what was taken out, how far that moved the odometry, and what remains."""
        from odomcorrupt.correction.summary import brief

        return brief(self.outcome, self.target)

    def details(self) -> str:
        """Return all of it in one paragraph."""
        from odomcorrupt.correction.summary import correction_summary

        return correction_summary(self.outcome)

    def to_dict(self) -> dict[str, Any]:
        """Return the effects taken out and left, what was moved, and by how much."""
        from odomcorrupt.report.json.numbers import finite

        outcome = self.outcome
        return dict(
            finite(
                {
                    "schema": 2,
                    "input": self.source,
                    "output": self.target,
                    "taken_out": [effect.name for effect in outcome.effects.undone],
                    "left": [effect.name for effect in outcome.effects.left],
                    "odometry": outcome.driver,
                    "moved": {**outcome.changes.odometry, **outcome.changes.edges},
                    "drift": asdict(outcome.drift),
                    "losses": list(outcome.losses),
                }
            )
        )

    def rows(self) -> list[dict[str, Any]]:
        """Return each effect and whether it was taken out."""
        undone, left = self.outcome.effects.undone, self.outcome.effects.left
        return [{"effect": e.name, "taken_out": e in undone} for e in (*undone, *left)]

    def _figure(self) -> Figure:
        """Return the measured path and the corrected one, read from the two bags."""
        from odomcorrupt.report.plots.corruption import draw_corruption
        from odomcorrupt.trajectories.reader import read_drive

        before, after = (read_drive(Path(path), self.outcome.driver) for path in (self.source, self.target))
        return draw_corruption(before.xyt, after.xyt, Path(self.target).name, names=("measured", "corrected"))


def correct(
    source: str | PathLike[str],
    target: str | PathLike[str],
    *,
    model: ModelLike | None = None,
    start_xyt: Sequence[float] | None = None,
    watch: Callable[[Block], None] = lambda _: None,
    **options: Unpack[BagOptions],
) -> Correction:
    """Take the systematic effects of a model out of measured odometry.

    Parameters
    ----------
    source, target : path
        Bags; the source is read twice and cannot be a pipe, the target may be "-".
    model : Model or path of a model file
        As `fit` and `learn` make it; None copies the bag.
    start_xyt : (3,), optional
        Where the odometry begins in the frame whose places effects read, metres and radians.
    watch : callable
        Called with every block written.
    **options
        See `BagOptions`.

    Returns
    -------
    Correction
        What was taken out and what cannot be, and by how much that moved the odometry.

    Raises
    ------
    BagError, TopicError, EffectError
        Where a bag cannot be read or written, there is no odometry, or no true motion explains it.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> model = oc.Model(effects=["wheelbase:e=2%"], track_m=0.3)
    >>> done = oc.correct("fixtures/office.mcap", "corrected.mcap", model=model, overwrite=True)
    >>> [effect.name for effect in done.outcome.effects.undone]
    ['wheelbase']

    """
    import numpy as np

    from odomcorrupt.correction.run import SILENT, correct_bag

    before = _path(source)
    if before is None:
        raise OdomCorruptError("-: correction reads a bag twice, which a pipe cannot give; name a file")
    moved, container = split_options(options)
    robot = SILENT if model is None else as_model(model).motion_model
    start = None if start_xyt is None else np.array(start_xyt, dtype=np.float64)
    outcome = correct_bag(
        before, _path(target), robot, options=moved, container=container, start_xyt=start, watch=watch
    )
    return Correction(fspath(source), fspath(target), outcome)


@dataclass(frozen=True, slots=True, repr=False)
class Batch(Result):
    """Many corrupted runs of one bag, or of several.

    directory : where they are
    jobs : one for each input and each point of a sweep
    made_now : how many runs this call made
    failures : runs that could not be made, and why
    """

    directory: Path
    jobs: tuple[Job, ...]
    made_now: int
    failures: tuple[Failure, ...]

    @property
    def seed(self) -> int:
        """Seed of all draws."""
        return self.jobs[0].seed

    @property
    def records(self) -> list[dict[str, Any]]:
        """What the manifest says of each run: file, command, seed, drift."""
        from odomcorrupt.batching.manifest import read_records

        return [record for job in self.jobs for _, record in sorted(read_records(job.directory).items())]

    @property
    def paths(self) -> list[Path]:
        """Files of the runs, in order."""
        from odomcorrupt.batching.manifest import read_records

        return [
            job.directory / record["file"]
            for job in self.jobs
            for _, record in sorted(read_records(job.directory).items())
        ]

    @property
    def losses(self) -> tuple[str, ...]:
        """What could not be read of damaged inputs, each once."""
        return tuple(dict.fromkeys(loss for record in self.records for loss in record.get("losses", ())))

    def __len__(self) -> int:
        return len(self.records)

    def summary(self) -> Summary:
        """Return how many runs there are, with their drift, and what failed."""
        from odomcorrupt.batching.summary import brief

        return brief(self.directory, self.records, self.made_now, self.seed, self.failures, self.losses)

    def details(self) -> str:
        """Return the same in sentences."""
        from odomcorrupt.batching.summary import sentences

        return sentences(self.directory, len(self.records), self.made_now, self.seed, self.failures, self.losses)

    def to_dict(self) -> dict[str, Any]:
        """Return the manifest: the directory, the seed, and a record of each run."""
        return {
            "schema": 2,
            "directory": str(self.directory),
            "seed": self.seed,
            "made_now": self.made_now,
            "failures": [{"run": run, "why": why} for run, why in self.failures],
            "runs": self.records,
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return a row for each run: its number, file and drift."""
        return [{"run": r["run"], "file": r["file"], "input": r["input"], **r.get("drift", {})} for r in self.records]

    def _figure(self) -> Figure:
        """Return how the runs spread with the distance, and what the linearised model predicts."""
        from odomcorrupt.batching.dispersion import measure
        from odomcorrupt.report.plots.dispersion import draw_spread

        return draw_spread(measure(self.jobs[0].directory))


def batch(
    inputs: PathLikes,
    directory: str | PathLike[str],
    *,
    model: ModelLike | None = None,
    runs: int,
    seed: int | None = None,
    output: Literal["full", "overlay", "trajectories"] = "full",
    robots: Literal["stated", "posterior"] = "stated",
    sweeps: Sequence[str] = (),
    jobs: int = 1,
    within: MapCondition | str | PathLike[str] | None = None,
    **options: Unpack[BagOptions],
) -> Batch:
    """Make runs 0 to n - 1 of a seed: the bytes that `corrupt` gives one by one, much faster; what is there stays.

    Parameters
    ----------
    inputs : path or several
        Bags.
    directory : path
        Where the runs go; manifest.jsonl there has the command that makes any single one.
    model : Model, Noise, path of a model file or name of a preset, optional
        By default the preset `typical`. Of a file, what it states as "a +- b" is drawn for each run.
    runs : int
        How many.
    seed : int, optional
        Of all draws; by default that of the batch in the directory, or one is drawn.
    output : {"full", "overlay", "trajectories"}
        Whole bags, only the changed topics, or only paths (TUM and npz).
    robots : {"stated", "posterior"}
        Draw for each run what the model states as "a +- b", or everything with a standard error.
    sweeps : sequence of str
        As "alpha-scale=0.5,1,2": every combination has a directory of its own.
    jobs : int
        Processes. In a script, call from under ``if __name__ == "__main__"``.
    within : MapCondition or path of a map's .yaml, optional
        As in `corrupt`.
    **options
        See `BagOptions`.

    Returns
    -------
    Batch
        The runs; `paths` are their files, `to_pandas()` their drift.

    Raises
    ------
    BatchError, BagError, TopicError, ModelError
        Where inputs would share a directory, the directory has another batch, or no run could be made.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> runs = oc.batch("fixtures/office.mcap", "runs", model="typical", runs=3, seed=1, output="trajectories")
    >>> len(runs.paths)
    3

    """
    from odomcorrupt.batching.plan import BatchSpec, plan, run_batch, seed_of

    moved, container = split_options(options)
    chosen = as_model(model)
    file = Path(fspath(model)) if isinstance(model, str | PathLike) and fspath(model).endswith(".toml") else None
    target = Path(fspath(directory))
    spec = BatchSpec(
        model=chosen.motion_model,
        seed=seed_of(target) if seed is None else seed,
        model_file=file,
        sweeps=tuple(sweeps),
        posterior=robots == "posterior",
        options=moved,
        container=container,
        output=output,
        condition=_condition(within),
    )
    planned = plan(as_paths(inputs), target, spec)
    made = run_batch(planned, range(runs), processes=jobs)
    return Batch(target, tuple(planned), made.runs, made.failures)

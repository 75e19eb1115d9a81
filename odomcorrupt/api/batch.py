"""Many runs of one bag: batches, their cost, their assembly, and the spread of their paths."""

from __future__ import annotations

import math
import os
from contextlib import nullcontext
from dataclasses import asdict, dataclass, replace
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack, cast

from odomcorrupt.api.bag_options import BagOptions, as_condition, split_options
from odomcorrupt.api.model import ModelLike, as_model
from odomcorrupt.api.recordings import PathLikes, as_paths
from odomcorrupt.api.result import Result
from odomcorrupt.bags.pipeline import default_threads
from odomcorrupt.batching.dispersion import measure
from odomcorrupt.batching.engine import Shard, need_of, require_odometry, require_space, run_batch
from odomcorrupt.batching.job import BatchSpec, Job, fleet_model, plan
from odomcorrupt.batching.manifest import fingerprint_of, read_beginning, read_records, seed_of
from odomcorrupt.batching.sinks import assemble_overlay
from odomcorrupt.corruption.summary import places_lines
from odomcorrupt.errors import BatchError, BatchOptionError
from odomcorrupt.model.model_file import read_model
from odomcorrupt.report.plain import picked
from odomcorrupt.summary import ALWAYS, MOST_LINES, USUAL, Line, Summary, command_line

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from contextlib import AbstractContextManager

    from matplotlib.figure import Figure

    from odomcorrupt.batching.dispersion import SpreadReport
    from odomcorrupt.batching.engine import Audience, Failure, Need
    from odomcorrupt.batching.job import Format, Output
    from odomcorrupt.mapping.conditioned import MapCondition


_ERRORS = 2.0
"""Standard errors beyond which a dispersion differs from the prediction."""


@dataclass(frozen=True, slots=True, repr=False)
class Batch(Result):
    """Many corrupted runs of one bag, or of several.

    directory : directory of the runs
    jobs : one per input and point of a sweep
    made_now : number of runs made by this call
    failures : runs that failed, with the reason
    """

    directory: Path
    jobs: tuple[Job, ...]
    made_now: int
    failures: tuple[Failure, ...]

    @property
    def seed(self) -> int:
        """Seed of all random draws."""
        return self.jobs[0].batch.seed

    @property
    def records(self) -> list[dict[str, Any]]:
        """Manifest records of the runs: file, command, seed, drift."""
        return [record for _, record in self._records()]

    @property
    def paths(self) -> list[Path]:
        """Files of the runs, in order of their numbers."""
        return [directory / record["file"] for directory, record in self._records()]

    def _records(self) -> list[tuple[Path, dict[str, Any]]]:
        return [(job.directory, record) for job in self.jobs for record in read_records(job.directory).values()]

    @property
    def losses(self) -> tuple[str, ...]:
        """Unreadable parts of damaged inputs, without repetition."""
        return self._said("losses")

    def _said(self, key: str) -> tuple[str, ...]:
        return tuple(dict.fromkeys(said for record in self.records for said in record.get(key, ())))

    def __len__(self) -> int:
        return len(self.records)

    def summary(self) -> Summary:
        """Return the number of runs, effects of places, the drift, the failures, and the next command."""
        made = f"{self.made_now} runs made now, {len(self)} in {self.directory}"
        lines = [Line("FAILED", made, "bad") if self.failures else Line("MADE", made, "good")]
        lines += [*places_lines(self.jobs[0].model), Line("seed", str(self.seed))]
        names = [os.path.relpath(job.directory, self.directory) for job in self.jobs]
        drifts = [(name, drift) for name, job in zip(names, self.jobs, strict=True) if (drift := _drift(job))]
        several = len(self.jobs) > 1
        for i, (name, said) in enumerate(drifts):
            lines.append(Line("" if i else "drift", said + f": {name}" * several, weight=ALWAYS if several else USUAL))
        if self.failures:
            (first, reason), runs = self.failures[0], ", ".join(str(run) for run, _ in self.failures)
            said = f"{len(self.failures)} runs, tried twice; run {first}: {reason}"
            lines.append(Line("failed", said, "bad", full=f"{said}; all of them: {runs}"))
        for label, key in (("lost", "losses"), ("note", "remarks")):
            lines += [Line(label, said, "warning") for said in self._said(key)]
        # a sweep has a spread at each of its points; one run has none
        words = ("odomcorrupt", "spread", self.directory / names[0]) if len(self) > len(self.jobs) else ()
        return Summary((*lines, command_line(words)), MOST_LINES + len(drifts))

    def _values(self) -> dict[str, Any]:
        return {
            "directory": str(self.directory),
            "seed": self.seed,
            "made_now": self.made_now,
            "failures": [{"run": run, "why": why} for run, why in self.failures],
            "runs": self.records,
        }

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per run: number, file and drift."""
        return [{"run": r["run"], "file": r["file"], "input": r["input"], **r.get("drift", {})} for r in self.records]

    def _figure(self) -> Figure:
        return Spread(measure(self.jobs[0].directory)).plot()


def _drift(job: Job) -> str:
    """Return the RMS drift at the end of a job's runs; "" if it is not known."""
    drifts = [one["drift"] for one in read_records(job.directory).values() if "end_drawn_m" in one.get("drift", {})]
    if not drifts:
        return ""
    metres, radians = (
        math.sqrt(sum(d[name] ** 2 for d in drifts) / len(drifts)) for name in ("end_drawn_m", "end_drawn_rad")
    )
    return f"{_size(metres, radians)} RMS at the end of {max(d['distance_m'] for d in drifts):.4g} m"


@dataclass(frozen=True, slots=True, repr=False)
class BatchCost(Result):
    """Time and disk space of the missing runs of a batch.

    result : number of runs, bytes, core seconds, free bytes, and bytes of overlays
    processes, output : number of processes, and what is written
    """

    result: Need
    processes: int
    output: Output

    def summary(self) -> Summary:
        """Return number of runs, space and time."""
        need, minutes = self.result, self.result.core_seconds / 60.0
        lacking = need.bytes > need.free_bytes
        text = (
            f"{need.runs} runs to make, about {need.bytes / 1e9:.3g} GB ({need.free_bytes / 1e9:.3g} GB are free) and "
            f"{minutes:.3g} core minutes"
        )
        text += f", {minutes / self.processes:.3g} minutes with {self.processes} processes" * (self.processes > 1) + "."
        if self.output == "full":
            saved = 1.0 - need.overlay_bytes / need.bytes if need.bytes else 0.0
            text += f" --output overlay would write {need.overlay_bytes / 1e9:.3g} GB, {saved:.0%} less."
        text += " The disk cannot hold it." * lacking
        return Summary((Line("NEEDS", text, "bad" if lacking else "good"),))

    def _values(self) -> dict[str, Any]:
        return asdict(self.result)


class BatchOptions(BagOptions, total=False):
    """Options of a batch, beside those of `BagOptions`.

    output : whole bags ("full", the default), only the changed topics ("overlay"), or only paths as TUM and npz
        ("trajectories")
    layout : chunks as in the input ("same"), or changed messages in chunks of their own ("split"), which is faster
    to : format of the runs: bag, mcap, db3 or directory; by default that of the input
    robots : draw for each run what the model states as "a +- b" ("stated"), or everything with a standard error
        ("posterior")
    fleet : model files of robots, instead of `model`: every run draws a robot by their mean and spread
    sweeps : such as "alpha-scale=0.5,1,2"; each combination gets its own directory. Ranges as "wheel_scale.e=0..0.02"
    points : number of Sobol points that cover all ranges
    within : map that no noisy pose leaves, as in `corrupt`
    also : odometry topics of other robots in the bag, as in `corrupt`
    jobs : number of processes. In a script, call from under ``if __name__ == "__main__"``
    shard : part of the runs to make, and number of parts, as (3, 16), counted from 1
    model_file : file of `model`, if that is not its path: what it states as "a +- b" is drawn for each run
    model_words, map_words : options for model and map in the command of a single run, as the manifest has it; by
        default the model file in the directory
    """

    output: Output
    layout: Literal["same", "split"]
    to: Format | None
    robots: Literal["stated", "posterior"]
    fleet: Sequence[str | PathLike[str]]
    sweeps: Sequence[str]
    points: int
    within: MapCondition | str | PathLike[str] | None
    also: Sequence[str]
    jobs: int
    shard: tuple[int, int] | None
    model_file: Path | None
    model_words: tuple[str, ...] | None
    map_words: tuple[str, ...]


def batch(
    inputs: PathLikes,
    directory: str | PathLike[str],
    *,
    model: ModelLike | None = None,
    runs: int,
    seed: int | None = None,
    verify: bool = False,
    dask: str | None = None,
    progress: Callable[[int], AbstractContextManager[Audience]] | None = None,
    **options: Unpack[BatchOptions],
) -> Batch:
    """Make runs 0 to n - 1 of a seed: the same bytes as single calls of `corrupt`, much faster; existing runs are kept.

    inputs : bags
    directory : directory of the runs; its manifest.jsonl has the command that makes any single one
    model : model, noise, model file or preset; by default the preset `typical`. Values that a file states as "a +- b"
        are drawn for each run
    runs : number of runs
    seed : seed of all random draws; by default that of the batch in the directory, or a random one
    verify : whether runs whose checksums differ from the manifest are made again
    dask : address of a Dask scheduler whose workers make the runs, as "tcp://host:8786"
    progress : called with the number of runs; returns a context manager with callbacks for progress
    **options : see `BatchOptions` and `BagOptions`

    Returns
    -------
    Batch
        The runs; `paths` are their files, `to_pandas()` their drift.

    Raises
    ------
    BatchError, BagError, TopicError, ModelError
        If options contradict each other, inputs would share a directory, the directory has another batch, the disk
        cannot hold the runs, or no run could be made.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> runs = oc.batch("fixtures/office.mcap", "runs", model="typical", runs=3, seed=1, output="trajectories")
    >>> len(runs.paths)
    3
    """
    if options.get("shard") and dask:
        raise BatchOptionError("--shard and --dask: both spread the runs; give one of them")
    jobs, shard = _plan(inputs, directory, model, runs, seed, options), Shard(*(options.get("shard") or (1, 1)))
    require_odometry(jobs)
    require_space(jobs, range(runs), shard)
    with nullcontext() if progress is None else progress(len(jobs) * runs) as audience:
        made = run_batch(
            jobs, range(runs), processes=options.get("jobs", 1), shard=shard, verify=verify, dask=dask,
            audience=audience,
        )  # fmt: skip
    failures = tuple((run, str(BatchError(why))) for run, why in made.failures)
    return Batch(Path(fspath(directory)), tuple(jobs), made.runs, failures)


def estimate_batch(
    inputs: PathLikes,
    directory: str | PathLike[str],
    *,
    model: ModelLike | None = None,
    runs: int,
    seed: int | None = None,
    **options: Unpack[BatchOptions],
) -> BatchCost:
    """Return the time and the disk space that the missing runs of a batch need, measured on the beginning of the bags.

    inputs, directory, model, runs, seed, **options : as of `batch`

    Returns
    -------
    BatchCost
        `result` has bytes and core seconds.

    Raises
    ------
    BatchError, BagError, TopicError, ModelError
        As by `batch`.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> oc.estimate_batch("fixtures/office.mcap", "many", runs=1000, output="overlay").result.runs
    1000
    """
    jobs = _plan(inputs, directory, model, runs, seed, options)
    need = need_of(jobs, range(runs), Shard(*(options.get("shard") or (1, 1))))
    return BatchCost(need, options.get("jobs", 1), jobs[0].batch.output)


def _plan(
    inputs: PathLikes,
    directory: str | PathLike[str],
    model: ModelLike | None,
    runs: int,
    seed: int | None,
    options: BatchOptions,
) -> list[Job]:
    """Return the jobs of a batch."""
    own = set(BatchOptions.__annotations__) - set(BagOptions.__annotations__)
    given: dict[str, Any] = {name: value for name, value in options.items() if name in own}
    moved, container = split_options(cast("BagOptions", {k: v for k, v in options.items() if k not in own}))
    alike = {name: given[name] for name in ("points", "output", "to", "model_words", "map_words") if name in given}
    jobs, fleet = given.get("jobs", 1), given.get("fleet", ())
    for name, count in (("runs", runs), ("jobs", jobs)):
        if count < 1:
            raise BatchError(f"{name}: {count}; make one or more")
    if fleet and model is not None:
        raise BatchOptionError("--fleet and --model: the files of a fleet are its whole model; leave --model out")
    if len(set(fleet)) < len(fleet):
        raise BatchOptionError("--fleet: a file is named twice; a robot counts once")
    robots = {fspath(path): read_model(Path(fspath(path))) for path in fleet}
    if given.get("shard") and seed is None:
        raise BatchOptionError("--shard: all shards need the same --seed; give one")
    file = given.get("model_file")
    if isinstance(model, str | PathLike) and fspath(model).endswith(".toml"):
        file = Path(fspath(model))
    target = Path(fspath(directory))
    spec = BatchSpec(
        model=fleet_model(robots) if fleet else as_model(model).motion_model,
        seed=seed_of(target) if seed is None else seed,
        model_file=file,
        sweeps=tuple(given.get("sweeps", ())),
        posterior=given.get("robots") == "posterior" or bool(fleet),
        options=moved,
        # an existing run is complete, and the threads are shared by the processes
        container=replace(container, overwrite=False, threads=max(1, (container.threads or default_threads()) // jobs)),
        split=given.get("layout") == "split",
        condition=as_condition(given.get("within")),
        also=tuple(given.get("also", ())),
        **alike,
    )
    return plan(as_paths(inputs), target, spec)


@dataclass(frozen=True, slots=True, repr=False)
class Assembly(Result):
    """A whole bag, written from an overlay and its original.

    path : the bag
    run, original : overlay, and the bag it was made from
    messages : number of messages of the overlay in it
    """

    path: Path
    run: Path
    original: Path
    messages: int

    def summary(self) -> Summary:
        """Return what replaces what."""
        text = f"{self.messages} messages of {self.run.name} in place of those of {self.original.name}"
        full = f"{self.path}: {self.messages} messages of {self.run} in place of those of {self.original}"
        return Summary((Line("ASSEMBLED", text, "good", full=full), command_line(["odomcorrupt", "info", self.path])))

    def _values(self) -> dict[str, Any]:
        return {"output": str(self.path), "messages": self.messages, "run": str(self.run), "input": str(self.original)}


def assemble(
    run: str | PathLike[str],
    output: str | PathLike[str],
    original: str | PathLike[str] | None = None,
    **options: Unpack[BagOptions],
) -> Assembly:
    """Write the whole bag of a run that `batch(..., output="overlay")` made, which has only the modified topics.

    run : overlay in the directory of its batch
    output : bag to write
    original : bag that the batch was made from; by default the one noted in the batch, if it is unchanged
    **options : see `BagOptions`; those that choose what is modified have no effect

    Returns
    -------
    Assembly
        The bag, and the number of replaced messages.

    Raises
    ------
    BatchError, BagError
        If the original is missing, has changed, or is not that of the overlay, or a bag cannot be read or written.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> runs = oc.batch("fixtures/office.mcap", "overlays", runs=1, seed=1, output="overlay")
    >>> oc.assemble(runs.paths[0], "whole.mcap").messages
    6000
    """
    overlay, target = Path(fspath(run)), Path(fspath(output))
    if original is None:
        noted = read_beginning(overlay.parent)["input"]
        source = Path(noted["path"])
        if not source.exists():
            raise BatchError(f"{source}: the batch's input is not there; name it with --input")
        if fingerprint_of(source) != noted["hash"]:
            raise BatchError(f"{source}: has changed since the batch was made from it; name the original with --input")
    else:
        source = Path(fspath(original))
    count = assemble_overlay(overlay, source, target, split_options(options)[1])
    return Assembly(target, overlay, source, count)


@dataclass(frozen=True, slots=True, repr=False)
class Spread(Result):
    """Dispersion of the runs of a batch, measured and predicted by the linearised model.

    result : complete numerical result: standard deviations after each distance, paths, errors of each run
    """

    result: SpreadReport

    def summary(self) -> Summary:
        """Return whether the dispersion at the end is as predicted, and its values along the drive."""
        report = self.result
        last = report.rows[-1]
        ratio = last.position_m / last.position_predicted_m if last.position_predicted_m else math.inf
        # standard error of the logarithm of the root of a sum of variances, estimated from this many normal errors
        chance = _ERRORS * math.sqrt(report.concentration / (2.0 * max(report.runs - 1, 1)))
        off = math.inf if not ratio else math.log(ratio)
        verdict = "AS PREDICTED" if abs(off) <= chance else "WIDER" if off > 0.0 else "NARROWER"
        by_chance = f"{report.runs} runs: {math.exp(-chance):.2f} to {math.exp(chance):.2f} by chance"
        said = f"{ratio:.3g} times the predicted spread after {last.after_m:.4g} m ({by_chance})"
        lines = [Line(verdict, said, "good" if abs(off) <= chance else "warning")]
        for row in (report.rows[i] for i in sorted({0, len(report.rows) // 2, len(report.rows) - 1})):
            measured = _size(row.position_m, row.heading_rad)
            predicted = _size(row.position_predicted_m, row.heading_predicted_rad)
            lines.append(Line(f"{row.after_m:.4g} m", f"{measured} (predicted {predicted})"))
        lines.append(Line("mean", f"{_size(last.mean_m, last.mean_rad)} off on average at the end"))
        if report.random_effects:
            lines.append(Line("note", f"not predicted: the draws of {', '.join(report.random_effects)}", "warning"))
        return Summary(tuple(lines))

    def _tables(self) -> str:
        degrees = math.degrees
        lines = [
            "standard deviations about their mean, and as linearised (predicted)",
            "   after m   position m   predicted   heading deg   predicted    mean m   mean deg",
        ]
        lines += [
            f"{row.after_m:10.4g} {row.position_m:12.4g} {row.position_predicted_m:11.4g} "
            f"{degrees(row.heading_rad):13.4g} {degrees(row.heading_predicted_rad):11.4g} "
            f"{row.mean_m:9.3g} {degrees(row.mean_rad):10.3g}"
            for row in self.result.rows
        ]
        return "\n".join(lines)

    def _values(self) -> dict[str, Any]:
        return picked(self.result, "directory", "runs", "random_effects") | {"rows": self.rows()}

    def rows(self) -> list[dict[str, Any]]:
        """Return one row per distance: standard deviations of the runs and predicted, and the mean error."""
        return [asdict(row) for row in self.result.rows]

    def _figure(self) -> Figure:
        from odomcorrupt.report.plots.samples import draw_spread

        return draw_spread(self.result)


def _size(position_m: float, heading_rad: float) -> str:
    return f"{position_m:.3g} m, {math.degrees(heading_rad):.3g} deg"


def spread(directory: str | PathLike[str]) -> Spread:
    """Return how position and heading of a batch's runs spread with distance, beside what the linear model predicts.

    directory : directory of a batch with at least two runs

    Returns
    -------
    Spread
        `rows()` and `to_pandas()` have the standard deviations after 1, 2, 5, 10 ... m and at the end.

    Raises
    ------
    BatchError
        If the directory has no batch of at least two runs.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> runs = oc.batch("fixtures/office.mcap", "spread", model="typical", runs=3, seed=1, output="trajectories")
    >>> oc.spread(runs.directory).result.runs
    3
    """
    return Spread(measure(Path(fspath(directory))))

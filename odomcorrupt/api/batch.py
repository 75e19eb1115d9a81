"""Many corrupted runs of one bag, or of several."""

from __future__ import annotations

import math
from dataclasses import dataclass
from os import PathLike, fspath
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Unpack

from odomcorrupt.api.bag_options import BagOptions, as_condition, split_options
from odomcorrupt.api.model import ModelLike, as_model
from odomcorrupt.api.recordings import PathLikes, as_paths
from odomcorrupt.api.result import Result
from odomcorrupt.batching.engine import run_batch
from odomcorrupt.batching.job import BatchSpec, Job, plan
from odomcorrupt.batching.manifest import read_records, seed_of
from odomcorrupt.corruption.summary import places_lines
from odomcorrupt.errors import BatchError
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from odomcorrupt.batching.runner import Failure
    from odomcorrupt.mapping.map_condition import MapCondition

_NAMED = 8
"""Failed runs that are named."""


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
        directories = [job.directory for job in self.jobs]
        return [(path, record) for path in directories for _, record in sorted(read_records(path).items())]

    @property
    def losses(self) -> tuple[str, ...]:
        """Unreadable parts of damaged inputs, without repetition."""
        return tuple(dict.fromkeys(loss for record in self.records for loss in record.get("losses", ())))

    def __len__(self) -> int:
        return len(self.records)

    def summary(self) -> Summary:
        """Return the number of runs, effects of places, the drift, the failures, and the next command."""
        records = self.records
        made = f"{self.made_now} runs made now, {len(records)} in {self.directory}"
        lines = [Line("FAILED", made, "bad") if self.failures else Line("MADE", made, "good")]
        lines += [*places_lines(self.jobs[0].model), Line("seed", str(self.seed))]
        drifts = [record["drift"] for record in records if "end_drawn_m" in record.get("drift", {})]
        if drifts:
            metres = math.sqrt(sum(d["end_drawn_m"] ** 2 for d in drifts) / len(drifts))
            radians = math.sqrt(sum(d["end_drawn_rad"] ** 2 for d in drifts) / len(drifts))
            far = max(d["distance_m"] for d in drifts)
            said = f"{metres:.3g} m, {math.degrees(radians):.3g} deg RMS at the end of {far:.4g} m"
            lines.append(Line("drift", said))
        if self.failures:
            first, reason = self.failures[0]
            lines.append(Line("failed", f"{len(self.failures)} runs, tried twice; run {first}: {reason}", "bad"))
        lines += [Line("lost", loss, "warning") for loss in self.losses]
        return Summary((*lines, command_line(["odomcorrupt", "spread", self.directory])))

    def details(self) -> str:
        """Return the summary in sentences, with the numbers of the failed runs."""
        said = f"{self.made_now} runs made now, {len(self)} in {self.directory}, seed {self.seed}."
        if self.failures:
            first, reason = self.failures[0]
            names = ", ".join(str(run) for run, _ in self.failures[:_NAMED])
            names += ", ..." if len(self.failures) > _NAMED else ""
            said += f" Not made, tried twice: {len(self.failures)} runs ({names}); run {first}: {reason}"
        return said + "".join(f" Lost: {loss}." for loss in self.losses)

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
        """Return one row per run: number, file and drift."""
        return [{"run": r["run"], "file": r["file"], "input": r["input"], **r.get("drift", {})} for r in self.records]

    def _figure(self) -> Figure:
        """Return a figure of dispersion against distance, with the prediction of the linearised model."""
        from odomcorrupt.batching.dispersion import measure
        from odomcorrupt.report.plots.samples import draw_spread

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
    points: int = 0,
    jobs: int = 1,
    within: MapCondition | str | PathLike[str] | None = None,
    **options: Unpack[BagOptions],
) -> Batch:
    """Make runs 0 to n - 1 of a seed: the same bytes as single calls of `corrupt`, much faster; existing runs are kept.

    Parameters
    ----------
    inputs : path or several
        Bags.
    directory : path
        Directory of the runs; its manifest.jsonl has the command that makes any single one.
    model : Model, Noise, path of a model file or name of a preset, optional
        By default the preset `typical`. Values that a file states as "a +- b" are drawn for each run.
    runs : int
        Number of runs.
    seed : int, optional
        Seed of all random draws; by default that of the batch in the directory, or a random one.
    output : {"full", "overlay", "trajectories"}
        Whole bags, only the changed topics, or only paths (TUM and npz).
    robots : {"stated", "posterior"}
        Draw for each run what the model states as "a +- b", or everything with a standard error.
    sweeps : sequence of str
        Such as "alpha-scale=0.5,1,2"; each combination gets its own directory. Ranges as "wheel_scale.e=0..0.02".
    points : int
        Number of Sobol points that cover all ranges.
    jobs : int
        Number of processes. In a script, call from under ``if __name__ == "__main__"``.
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
        If inputs would share a directory, the directory has another batch, or no run could be made.

    Examples
    --------
    >>> import odomcorrupt as oc
    >>> runs = oc.batch("fixtures/office.mcap", "runs", model="typical", runs=3, seed=1, output="trajectories")
    >>> len(runs.paths)
    3
    """
    moved, container = split_options(options)
    if runs < 1:
        raise BatchError(f"runs: {runs}; make one or more")
    chosen = as_model(model)
    file = Path(fspath(model)) if isinstance(model, str | PathLike) and fspath(model).endswith(".toml") else None
    target = Path(fspath(directory))
    spec = BatchSpec(
        model=chosen.motion_model,
        seed=seed_of(target) if seed is None else seed,
        model_file=file,
        sweeps=tuple(sweeps),
        points=points,
        posterior=robots == "posterior",
        options=moved,
        container=container,
        output=output,
        condition=as_condition(within),
    )
    planned = plan(as_paths(inputs), target, spec)
    made = run_batch(planned, range(runs), processes=jobs)
    failures = tuple((run, str(BatchError(why))) for run, why in made.failures)
    return Batch(target, tuple(planned), made.runs, failures)

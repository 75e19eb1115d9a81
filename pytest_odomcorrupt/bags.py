"""Corrupted bags of a clean one, made once and kept by content."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import odomcorrupt
from odomcorrupt.api.model import as_model
from odomcorrupt.batching.engine import ALL, attempt, missing_runs, tasks_of
from odomcorrupt.batching.job import BatchSpec, plan
from odomcorrupt.batching.manifest import begin, fingerprint_of, read_records, write_manifest
from odomcorrupt.corruption.transform import Options
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.scoring.errors import Alignment, PathErrors, path_errors
from odomcorrupt.scoring.run import read_estimate
from odomcorrupt.study.io.text import is_text

if TYPE_CHECKING:
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["CorruptedBag", "corrupted"]


@dataclass(frozen=True, slots=True)
class CorruptedBag:
    """One corrupted run of a clean bag.

    path : the bag
    run, seed : which draws
    clean_tum : the odometry before it was corrupted, a TUM file
    drift : what the manifest says of its drift, metres and radians
    """

    path: Path
    run: int
    seed: int
    clean_tum: Path
    drift: dict[str, float]

    @property
    def name(self) -> str:
        """What a baseline and a failing gate call the run: run, seed and file."""
        return f"run {self.run}, seed {self.seed}, {self.path.name}"

    def errors(
        self,
        estimate: Path | str | Trajectory | tuple[Path | str, str],
        topic: str | None = None,
        *,
        truth: Path | str | None = None,
        align: Alignment = "rigid",
    ) -> PathErrors:
        """Return the errors of an estimate of this run; `errors(...).metrics()["ate_m"]` is its ATE.

        Parameters
        ----------
        estimate
            A trajectory, a TUM or CSV file, a bag, or a bag and its topic.
        topic
            Topic or edge of TF with the estimate, in a bag.
        truth
            Topic or edge of TF of this run's bag, or a TUM or CSV file. None: the odometry before it was corrupted.
        align
            As `odomcorrupt.scoring.errors.path_errors` has it.
        """
        covariance = None
        if isinstance(estimate, tuple):
            estimate, topic = estimate
        if isinstance(estimate, str | Path):
            read = read_estimate(Path(estimate), topic)
            estimate, covariance = read.trajectory, read.covariance
        file = self.clean_tum if truth is None else Path(truth)
        reference = read_estimate(file) if is_text(file) else read_estimate(self.path, str(truth))
        return path_errors(estimate, reference.trajectory, align=align, covariance=covariance)


def corrupted(
    clean: Path | str,
    model: MotionModel | Path | str = "typical",
    *,
    runs: int = 40,
    seed: int = 0,
    cache: Path,
    **options: Any,
) -> tuple[CorruptedBag, ...]:
    """Return runs 0 to `runs` - 1 of a seed in their order, made where the cache does not have them.

    Parameters
    ----------
    clean
        The bag.
    model
        A model, the file of one, or the name of a preset.
    runs, seed
        How many, of which draws.
    cache
        Directory in which bags are kept under a hash of the clean bag's bytes, the model, the seed and the options.
    options
        Fields of `odomcorrupt.corruption.transform.Options`, such as odom_topic="/odom".

    Raises
    ------
    OdomCorruptError
        Where a run cannot be made.
    """
    source, chosen = Path(clean), as_model(model).motion_model
    if runs < 1:
        raise OdomCorruptError(f"runs: {runs}; it takes one or more")
    if not source.exists():
        raise OdomCorruptError(f"{source}: there is no such bag")
    fingerprint = fingerprint_of(source)
    given = Options(**options)
    text = repr((fingerprint, chosen, seed, given, odomcorrupt.__version__))
    directory = cache / f"{source.stem}-{hashlib.sha256(text.encode()).hexdigest()[:20]}"
    file = Path(model) if isinstance(model, str | Path) and Path(model).is_file() else None
    (job,) = plan([source], directory, BatchSpec(model=chosen, model_file=file, seed=seed, options=given))
    begin(job, fingerprint)
    todo = missing_runs(job, range(runs), ALL)
    failures = [failure for task in tasks_of(job, todo, 1) for failure in attempt(task)]
    if failures:
        raise OdomCorruptError(f"{source}: run {failures[0][0]} cannot be made: {failures[0][1]}")
    write_manifest(directory)
    records = read_records(directory)
    return tuple(
        CorruptedBag(directory / records[run]["file"], run, seed, directory / "clean.tum", records[run]["drift"])
        for run in range(runs)
    )

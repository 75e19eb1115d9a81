"""Predictive checks: corrupted runs along the truth's path against the measured odometry, and their size of drift.

The truth's path is smoothed (its noise would count as motion) and corrupted by the same code as bags; the error is
added to the measured truth. A robust fit excludes slips, so a simulation never slips: `reproduction_of` compares the
error after 10 s with the measured one (a posterior predictive check: Gelman, Meng & Stern 1996, Statistica Sinica 6),
and its share from outliers. Odometry noise accumulates and errors of a truth do not, so the error over a quarter of the
drive shows whether truth errors were mistaken for noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.stats import f as fisher_f

from odomcorrupt.corruption.inverse import SystematicEffects
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.geometry.se2 import Increments, accumulate, between, compose, increments, inverse, wrap
from odomcorrupt.geometry.trajectory import Trajectory, distance_along
from odomcorrupt.rng import stream
from odomcorrupt.study.estimate.outliers import events
from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.estimate.regressors import MotionSmoother
from odomcorrupt.study.estimate.windows import WINDOW_S, drift_of
from odomcorrupt.study.io.clock import aligned
from odomcorrupt.study.io.headings import with_recomputed_headings
from odomcorrupt.study.io.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel, TruthNoise
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.outliers import Event
    from odomcorrupt.study.validate.evaluation import Evaluation

_MAX_POSES = 1500
"""Poses kept of each path, for plots and statistics."""
_MIN_RUNS = 20


@dataclass(frozen=True, slots=True)
class Replay:
    """Corrupted runs and measured odometry at m poses of one stretch of a recording, in the truth's frame.

    distance_m : (m,) travelled by the truth
    truth_xyt, measured_xyt : (m, 3) truth, and the odometry aligned with the truth's first pose
    runs_xyt : (r, m, 3) corrupted runs
    """

    distance_m: Array
    truth_xyt: Array
    measured_xyt: Array
    runs_xyt: Array

    def inside(self, at: NDArray[np.int64], part: float = 0.9) -> NDArray[np.bool_]:
        """Return for selected poses whether the measured pose is inside the prediction region of probability `part`.

        The region is the ellipsoid of the runs about their mean, in x, y and heading jointly, with the size of a
        prediction region for this number of runs (Hotelling's T squared).
        """
        count = len(self.runs_xyt)
        off = between(self.truth_xyt[at], self.runs_xyt[:, at])
        own = between(self.truth_xyt[at], self.measured_xyt[at])
        off[..., 2] = np.unwrap(off[..., 2], axis=1)
        mean = off.mean(axis=0)
        spread = np.einsum("rmi,rmj->mij", off - mean, off - mean) / (count - 1.0)
        spread[:, [0, 1, 2], [0, 1, 2]] += 1e-12
        gap = own - mean
        gap[:, 2] = wrap(gap[:, 2])
        square = np.sum(np.linalg.solve(spread, gap[:, :, None])[:, :, 0] * gap, axis=1)
        limit = 3.0 * (count - 1.0) * (count + 1.0) / (count * (count - 3.0)) * fisher_f.ppf(part, 3, count - 3)
        return square <= limit


def replay(piece: Evaluation, *, runs: int = 100) -> Replay:
    """Return corrupted runs along a stretch's truth, beside its odometry with the measurement's effects removed."""
    if runs < _MIN_RUNS:
        raise ValueError(f"runs: {runs}; give {_MIN_RUNS} or more: fewer do not determine the covariance of the runs")
    model = piece.model
    measured = overlapping(undo(piece.recording, model.setup.effects))
    smooth, truth = smooth_truth(measured)
    stamps = measured.odometry.stamps_ns
    kept = np.unique(np.linspace(0, len(stamps) - 1, min(_MAX_POSES, len(stamps))).astype(np.int64))
    travelled = distance_along(smooth)
    starts = stream(0, 0, "replay").standard_normal((runs, 3)) * np.array(
        [piece.truth.xy_m, piece.truth.xy_m, piece.truth.yaw_rad]
    )
    first, poses = truth[0], np.empty((runs, len(kept), 3))
    for run, error in enumerate(_errors_of_runs(model, stamps, smooth, runs)):
        # The true start is uncertain: the truth's noise turns and shifts the whole run.
        poses[run] = compose(compose(compose(first, starts[run]), inverse(first)), truth[kept] + error[kept])
    own = compose(first, between(measured.odometry.xyt[0], measured.odometry.xyt[kept]))
    return Replay(travelled[kept], truth[kept], own, poses)


def _errors_of_runs(model: MotionModel, stamps_ns: NDArray[np.int64], path: Array, runs: int) -> Iterator[Array]:
    """Yield the errors (n, 3) of corrupted runs along a path (n, 3)."""
    systematic = SystematicEffects(model)
    for run in range(runs):
        yield NoisyPath(model, 0, run, covariance=False, systematic=systematic).feed(stamps_ns, path).error_xyt


def overlapping(recording: Recording) -> Recording:
    """Return the recording with the odometry restricted to the time of the truth."""
    odometry, truth = recording.odometry, recording.truth
    inside = (odometry.stamps_ns >= truth.stamps_ns[0]) & (odometry.stamps_ns <= truth.stamps_ns[-1])
    return replace(recording, odometry=odometry.only(inside))


def smooth_truth(recording: Recording) -> tuple[Array, Array]:
    """Return the truth at the odometry's stamps, smoothed (n, 3) and as measured (n, 3)."""
    truth = recording.truth.at(recording.odometry_s, recording.origin_ns)
    m = MotionSmoother([recording], "truth").recorded
    steps = m.twist * m.dt_s[:, None]
    if np.abs(steps[:, 1]).sum() < 0.1 * np.abs(steps[:, 0]).sum():
        steps[:, 1] = 0.0
    return accumulate(truth[0], Increments.of_rows(steps)), truth


_RUNS = 10
_FACTOR = 2.0
"""Factor beyond which errors differ, unless single runs of the model differ as much."""
_MAIN_CAUSE = 0.5
"""Fraction of the squared error above which outliers are its main cause."""
_LONG, _MIN_LONG_S = 0.25, 30.0
"""Fraction of the drive for the long-term error, and its shortest duration, seconds."""


class LongDrift(NamedTuple):
    """Position errors (m, RMS) after a long time, as in `Reproduction`: measured, of all runs, and of the best run."""

    after_s: float
    measured_m: float
    drawn_m: float
    least_m: float

    @property
    def too_large(self) -> bool:
        """Whether the model drifts clearly more than the recordings."""
        return self.drawn_m > _FACTOR * self.measured_m and self.measured_m < self.least_m


@dataclass(frozen=True, slots=True, kw_only=True)
class Reproduction:
    """Position errors after 10 s (m, RMS) of the recorded odometry, and of a model on the same drives.

    measured_m : of the odometry with corrected clock, without excursions of the truth
    drawn_m, least_m, most_m : of corrupted runs with noise like the truth's: all of them, the best, the worst
    outliers : number of lasting stretches that the fit excluded or down-weighted
    outlier_s : their total duration, s
    outlier_share : their fraction of the squared measured error
    long : errors after a quarter of the drive; None if that is too short
    """

    measured_m: float
    drawn_m: float
    least_m: float
    most_m: float
    outliers: int
    outlier_s: float
    outlier_share: float
    long: LongDrift | None = None

    @property
    def too_small(self) -> bool:
        """Whether the model drifts clearly less than the recordings."""
        return self.measured_m > _FACTOR * self.drawn_m and self.measured_m > self.most_m

    @property
    def too_large(self) -> bool:
        """Whether the model drifts clearly more than the recordings, after 10 s or in the long run."""
        at_once = LongDrift(WINDOW_S, self.measured_m, self.drawn_m, self.least_m)
        return at_once.too_large or (self.long is not None and self.long.too_large)

    @property
    def holds(self) -> bool:
        """Whether the model drifts about as much as the recordings."""
        return not (self.too_small or self.too_large)

    @property
    def by_outliers(self) -> bool:
        """Whether stretches excluded from the fit cause most of the error."""
        return self.outlier_share > _MAIN_CAUSE


def reproduction_of(
    fit: Fit, model: MotionModel, recordings: Sequence[Recording] = (), *, runs: int = _RUNS
) -> Reproduction:
    """Return the 10 s errors of the fitted recordings and of a model that corrupts the same drives.

    fit : to the recordings, with its outliers
    model : the model for corruption, as written to a file
    recordings : as recorded, because the model loses increments that the fit restored; default: those of the fit
    runs : number of corrupted runs of each drive
    """
    problem, left_out = fit.problem, events(fit)
    measured, calm = list[Recording](), list[Recording]()
    drawn = [list[Recording]() for _ in range(runs)]
    for recording, clock in zip(recordings or problem.recordings, problem.clocks, strict=True):
        whole = overlapping(undo(with_recomputed_headings(aligned(recording, clock)), model.setup.effects))
        own = [event for event in left_out if event.recording == recording.name]
        without_excursions = _replaced(whole, [event for event in own if not event.lasting])
        measured.append(without_excursions)
        calm.append(_replaced(without_excursions, [event for event in own if event.lasting]))
        for run, simulated in enumerate(_corrupted(whole, model, fit.noise.truth, runs)):
            drawn[run].append(simulated)
    drawn = [one for one in drawn if one]
    squares = [_mean_square(one) for one in (measured, calm)]
    each = np.sqrt([_mean_square(one) for one in drawn] or [np.nan])
    lasting = [event for event in left_out if event.lasting]
    return Reproduction(
        measured_m=float(np.sqrt(squares[0])),
        drawn_m=float(np.sqrt(np.mean(each**2))),
        least_m=float(each.min()),
        most_m=float(each.max()),
        outliers=len(lasting),
        outlier_s=sum(event.end_s - event.start_s for event in lasting),
        outlier_share=max(1.0 - squares[1] / squares[0], 0.0) if squares[0] > 0.0 else 0.0,
        long=_long_drift(measured, drawn),
    )


def _long_drift(measured: Sequence[Recording], drawn: Sequence[Sequence[Recording]]) -> LongDrift | None:
    after_s = _LONG * max(float(one.odometry_s[-1] - one.odometry_s[0]) for one in measured)
    if after_s < _MIN_LONG_S or not drawn:
        return None
    each = [_mean_square(one, after_s) for one in drawn]
    return LongDrift(after_s, *map(sqrt, (_mean_square(measured, after_s), float(np.mean(each)), min(each))))


def _mean_square(recordings: Sequence[Recording], after_s: float = WINDOW_S) -> float:
    squared = np.concatenate(drift_of([with_recomputed_headings(one) for one in recordings], after_s).squared)
    return float(np.mean(squared)) if len(squared) else float("nan")


def _replaced(recording: Recording, stretches: Sequence[Event]) -> Recording:
    """Return a recording whose odometry moves like the truth in some stretches and is unchanged elsewhere."""
    if not stretches:
        return recording
    t_s = recording.odometry_s
    own, true = (increments(xyt) for xyt in (recording.odometry.xyt, recording.truth.at(t_s, recording.origin_ns)))
    inside = np.zeros(len(own), dtype=bool)
    for event in stretches:
        inside |= (t_s[1:] > event.start_s) & (t_s[:-1] < event.end_s)
    mixed = Increments.of_rows(np.where(inside[:, None], true.rows, own.rows))
    path = accumulate(recording.odometry.xyt[0], mixed)
    return replace(recording, odometry=Trajectory(recording.odometry.stamps_ns, path))


def _corrupted(recording: Recording, model: MotionModel, truth: TruthNoise, runs: int) -> list[Recording]:
    """Return corrupted runs along a recording's truth, each with a noisy truth; none if the model cannot corrupt it."""
    smooth, _ = smooth_truth(recording)
    stamps, inside = recording.odometry.stamps_ns, recording.within_odometry
    truth_s = recording.truth_s[inside]
    true = Trajectory(stamps, smooth).at(truth_s, recording.origin_ns)
    if not recording.headed:
        true[:, 2] = np.where(np.isfinite(true[:, 2]), true[:, 2], 0.0)
    found = []
    try:
        for run, error in enumerate(_errors_of_runs(model, stamps, smooth, runs)):
            noisy = true + _noise(truth, truth_s, run, headed=recording.headed)
            seen = Trajectory(recording.truth.stamps_ns[inside], noisy)
            found.append(replace(recording, odometry=Trajectory(stamps, smooth + error), truth=seen))
    except OdomCorruptError:
        return []
    return found


def _noise(truth: TruthNoise, t_s: Array, run: int, *, headed: bool) -> Array:
    """Return noise (n, 3) like a truth's at times (n,): white noise, and a random walk of the position."""
    rng = stream(0, run, "reproduction")
    level = [truth.xy_m, truth.xy_m, truth.yaw_rad if headed else 0.0]
    white = rng.standard_normal((len(t_s), 3)) * level
    steps = rng.standard_normal((len(t_s), 2)) * np.sqrt(np.diff(t_s, prepend=t_s[:1]))[:, None] * truth.random_walk
    white[:, :2] += np.cumsum(steps, axis=0)
    return white

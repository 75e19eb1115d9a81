"""Whether a model drifts about as much as the recordings it was learned from, what a fit left out included.

A robust fit sets slips apart, and the noise that it estimates is that of the rest. As a description of the rest it is
right; a simulation that is corrupted with it never slips. So the model corrupts the truth's path, noise like the
truth's is added, and the error after 10 s is held against the measured one (a posterior predictive check: Gelman, Meng
& Stern 1996, Statistica Sinica 6), with the part of it that the outliers carry.

After 10 s most of the measured error may be the truth's own. Noise adds up from there on, and errors of a truth do not:
over a quarter of the drive it shows whether these were taken for noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import sqrt
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.errors import OdomCorruptError
from odomcorrupt.geometry.increments import Increments, accumulate, increments
from odomcorrupt.rng import stream
from odomcorrupt.study.estimate.outliers import events
from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.estimate.windows import WINDOW_S, phased_misses
from odomcorrupt.study.io.clock import aligned
from odomcorrupt.study.io.headings import with_recomputed_headings
from odomcorrupt.study.io.recording import Recording, Trajectory
from odomcorrupt.study.validate.predictive_check import overlapping, smooth_truth

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import MotionModel, TruthNoise
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.outliers import Event

__all__ = ["LongDrift", "Reproduction", "reproduction_of"]

_RUNS = 10
_FACTOR = 2.0
"""Errors that differ by more are not about the same, unless single runs of the model differ as much."""
_MOSTLY = 0.5
"""Part of the squared error that outliers carry at least where they are its main cause."""
_LONG, _LEAST_S = 0.25, 30.0
"""Part of the drive over which noise shows beside the truth's own errors, and the shortest that is long for it."""


class LongDrift(NamedTuple):
    """Position errors (m, RMS) after a long time, as `Reproduction` has them after 10 s: recorded, drawn, the least."""

    after_s: float
    measured_m: float
    drawn_m: float
    least_m: float

    @property
    def too_large(self) -> bool:
        """Whether the model drifts plainly more than the recordings."""
        return self.drawn_m > _FACTOR * self.measured_m and self.measured_m < self.least_m


@dataclass(frozen=True, slots=True, kw_only=True)
class Reproduction:
    """Position errors after 10 s (m, RMS): of the recorded odometry, and of what a model makes of the same drives.

    measured_m : of the odometry, its clock right, without excursions of the truth alone
    drawn_m, least_m, most_m : of corrupted runs with noise like the truth's: all of them, the best, the worst
    outliers : how many lasting stretches the fit left out, or weighed less
    outlier_s : how long they last together, s
    outlier_share : part of the squared measured error that they carry
    long : the errors after a quarter of the drive; None where it is too short
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
        """Whether the model drifts plainly less than the recordings."""
        return self.measured_m > _FACTOR * self.drawn_m and self.measured_m > self.most_m

    @property
    def too_large(self) -> bool:
        """Whether the model drifts plainly more than the recordings, at once or in the long run."""
        at_once = LongDrift(WINDOW_S, self.measured_m, self.drawn_m, self.least_m)
        return at_once.too_large or (self.long is not None and self.long.too_large)

    @property
    def holds(self) -> bool:
        """Whether the model drifts about as much as the recordings."""
        return not (self.too_small or self.too_large)

    @property
    def by_outliers(self) -> bool:
        """Whether stretches that the fit left out carry most of the error."""
        return self.outlier_share > _MOSTLY


def reproduction_of(fit: Fit, model: MotionModel, *, runs: int = _RUNS) -> Reproduction:
    """Return the 10 s errors of the fitted recordings beside those of a model that corrupts the same drives.

    Parameters
    ----------
    fit : to the recordings, with its outliers
    model : what is to be corrupted with, as it is written
    runs : corrupted runs of each drive

    """
    problem, left_out = fit.problem, events(fit)
    measured, calm = list[Recording](), list[Recording]()
    drawn = [list[Recording]() for _ in range(runs)]
    for recording, clock in zip(problem.recordings, problem.clocks, strict=True):
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
    if after_s < _LEAST_S or not drawn:
        return None
    each = [_mean_square(one, after_s) for one in drawn]
    squares = (_mean_square(measured, after_s), float(np.mean(each)), min(each))
    return LongDrift(after_s, *(sqrt(square) for square in squares))


def _mean_square(recordings: Sequence[Recording], after_s: float = WINDOW_S) -> float:
    squared = np.concatenate(phased_misses([with_recomputed_headings(one) for one in recordings], after_s))
    return float(np.mean(squared)) if len(squared) else float("nan")


def _replaced(recording: Recording, stretches: Sequence[Event]) -> Recording:
    """Return a recording whose odometry moves as the truth does in some stretches, and as it did between them."""
    if not stretches:
        return recording
    t_s = recording.odometry_s
    own, true = (increments(xyt) for xyt in (recording.odometry.xyt, recording.truth.at(t_s, recording.origin_ns)))
    inside = np.zeros(len(own), dtype=bool)
    for event in stretches:
        inside |= (t_s[1:] > event.start_s) & (t_s[:-1] < event.end_s)
    mixed = (
        np.where(inside, there, here)
        for here, there in ((own.ds_m, true.ds_m), (own.dl_m, true.dl_m), (own.dtheta_rad, true.dtheta_rad))
    )
    path = accumulate(recording.odometry.xyt[0], Increments(*mixed))
    return replace(recording, odometry=Trajectory(recording.odometry.stamps_ns, path))


def _corrupted(recording: Recording, model: MotionModel, truth: TruthNoise, runs: int) -> list[Recording]:
    """Return runs of a model along the truth of a recording, each with a truth that is as noisy; none if it cannot."""
    smooth, _ = smooth_truth(recording)
    stamps, origin = recording.odometry.stamps_ns, recording.origin_ns
    truth_s = recording.truth.seconds_since(origin)
    inside = (truth_s >= recording.odometry_s[0]) & (truth_s <= recording.odometry_s[-1])
    path = Trajectory(stamps, smooth)
    true = path.at(truth_s[inside], origin)
    if not recording.headed:
        true[:, 2] = np.where(np.isfinite(true[:, 2]), true[:, 2], 0.0)
    found = []
    for run in range(runs):
        try:
            error = NoisyPath(model, 0, run, covariance=False).feed(stamps, smooth).error_xyt
        except OdomCorruptError:
            return []
        noisy = true + _noise(truth, truth_s[inside], run, headed=recording.headed)
        found.append(
            replace(
                recording,
                odometry=Trajectory(stamps, smooth + error),
                truth=Trajectory(recording.truth.stamps_ns[inside], noisy),
            )
        )
    return found


def _noise(truth: TruthNoise, t_s: Array, run: int, *, headed: bool) -> Array:
    """Return noise (n, 3) like a truth's at times (n,): white, and a random walk of the position."""
    rng = stream(0, run, "reproduction")
    level = [truth.xy_m, truth.xy_m, truth.yaw_rad if headed else 0.0]
    white = rng.standard_normal((len(t_s), 3)) * level
    steps = rng.standard_normal((len(t_s), 2)) * np.sqrt(np.diff(t_s, prepend=t_s[:1]))[:, None] * truth.random_walk
    white[:, :2] += np.cumsum(steps, axis=0)
    noise: Array = white
    return noise

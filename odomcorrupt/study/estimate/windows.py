"""Windows of fixed time or distance: errors of the odometry at their ends, and the errors that a model predicts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.stats import norm

from odomcorrupt.geometry.se2 import between
from odomcorrupt.geometry.trajectory import distance_along
from odomcorrupt.study.estimate.interval_ends import pick_interval_ends
from odomcorrupt.study.estimate.intervals import intervals_between, join
from odomcorrupt.study.estimate.whitener import FLOOR, interval_covariance

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array, Increments
    from odomcorrupt.model.motion_model import Noise, TruthNoise
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.estimate.position_windows import PositionWindows
    from odomcorrupt.study.io.recording import Recording

WINDOW_S = 10.0


def time_windows(recording: Recording, length_s: float = WINDOW_S, phase: float = 0.0) -> Intervals:
    """Return non-overlapping complete windows of a fixed duration, each started at the truth pose.

    length_s : duration of a window
    phase : offset of the first window, as a fraction of a window's length
    """
    ends = _time_ends(recording, length_s, phase)
    return intervals_between(recording, ends.picked, ends.kept)


class _Ends(NamedTuple):
    """Indices of truth samples at which windows begin and end, and indices of the complete windows between them."""

    picked: NDArray[np.int64]
    kept: NDArray[np.int64]


def _time_ends(recording: Recording, length_s: float, phase: float) -> _Ends:
    """Return windows one after another, restarted after each stretch without truth if a grid would lose most windows.

    Each window with an end in such a stretch is lost, and with it the next. Restarted windows begin where the truth
    does, often at its least accurate poses, and hardly differ between phases.
    """
    odo_s, truth_s = recording.odometry_s, recording.truth_s
    known, first_s = recording.truth.known, odo_s[0] + phase * length_s
    picked = pick_interval_ends(truth_s, first_s, odo_s[-1], length_s, known)
    complete = _complete(truth_s[picked], length_s)
    if 2 * np.count_nonzero(complete) < len(complete):
        usable = np.flatnonzero(known & (truth_s >= first_s) & (truth_s <= odo_s[-1]))
        picked = usable[_restarted(truth_s[usable], length_s)]
    return _Ends(picked, np.flatnonzero(_complete(truth_s[picked], length_s)))


def _complete(ends_s: Array, length_s: float) -> NDArray[np.bool_]:
    """Return which intervals (n - 1,) between times (n,) are of the wanted length, to a tenth."""
    return np.abs(np.diff(ends_s) - length_s) < 0.1 * length_s


def _restarted(usable_s: Array, length_s: float) -> NDArray[np.int64]:
    """Return indices of the ends of windows among times (n,) with gaps; each row of windows is on a grid of its own."""
    ends = np.searchsorted(usable_s, usable_s + length_s - 1e-9)
    beyond = usable_s[np.minimum(ends, len(usable_s) - 1)]
    starts = np.flatnonzero((ends < len(usable_s)) & (beyond - usable_s < 1.1 * length_s))
    found, begin = [0], 0
    while (at := int(np.searchsorted(starts, begin))) < len(starts):
        begin = int(starts[at])
        grid = np.arange(usable_s[begin], usable_s[-1] + length_s, length_s) - 1e-9
        row = np.minimum(np.searchsorted(usable_s, grid), len(usable_s) - 1)
        whole = _complete(usable_s[row], length_s)
        count = len(whole) if whole.all() else int(np.argmin(whole))
        found += row[: count + 1].tolist()
        begin = int(row[count])
    return np.unique(found)


def distance_windows(recording: Recording, length_m: float, phase: float = 0.0) -> Intervals:
    """Return non-overlapping windows of a fixed path length, measured by the odometry, each started at the truth pose.

    length_m : path length of a window
    phase : offset of the first window, as a fraction of a window's length
    """
    inside = np.flatnonzero(recording.within_odometry & recording.truth.known)
    travelled = distance_along(recording.odometry.xyt)
    at_truth = np.interp(recording.truth_s[inside], recording.odometry_s, travelled)
    marks = np.arange(at_truth[0] + phase * length_m, at_truth[-1], length_m)
    if not len(marks):
        # a robot that stands, or stops before the first mark, has no window: one end makes none
        marks = at_truth[:1]
    picked = np.unique(inside[np.minimum(np.searchsorted(at_truth, marks), len(inside) - 1)])
    return intervals_between(recording, picked)


def rmse(windows: Intervals) -> float:
    """Return the root mean square position error (m) at the ends of windows started at the truth pose; NaN if none."""
    miss = windows.odometry_step[:, :2] - windows.truth_step[:, :2]
    return float(np.sqrt(np.mean(np.sum(miss**2, axis=1)))) if len(miss) else float("nan")


def joint_rmse(windows: Iterable[Intervals]) -> float:
    """Return the `rmse` over the windows of several recordings together; NaN if there is no window."""
    whole = [w for w in windows if len(w)]
    return rmse(join(whole, [0] * len(whole))) if whole else float("nan")


def phased_misses(recordings: Sequence[Recording], length_s: float = WINDOW_S) -> list[Array]:
    """Return squared position errors (n,) at window ends, m^2, for five phases: a steadier estimate than one phase."""
    phases = np.arange(5) / 5.0
    return [np.concatenate([_squared_misses(run, length_s, phase) for run in recordings]) for phase in phases]


def phased_rmse(recordings: Sequence[Recording]) -> float:
    """Return the root mean square position error (m) of `phased_misses`; NaN if there is no complete window."""
    squared = np.concatenate(phased_misses(recordings))
    return float(np.sqrt(np.mean(squared))) if len(squared) else float("nan")


def _squared_misses(recording: Recording, length_s: float, phase: float) -> Array:
    """Return squared position errors (n,) at the ends of `time_windows`, m^2; only the end poses are computed."""
    ends = _time_ends(recording, length_s, phase)
    at_s, truth_xyt = recording.truth_s[ends.picked], recording.truth.xyt[ends.picked]
    odometry_xyt = recording.odometry.at(at_s, recording.origin_ns)
    first, last = ends.kept, ends.kept + 1
    went = between(odometry_xyt[first], odometry_xyt[last]) - between(truth_xyt[first], truth_xyt[last])
    return np.sum(went[:, :2] ** 2, axis=1)


@dataclass(frozen=True, slots=True)
class WindowErrors:
    """Errors (odometry minus truth) at the ends of n windows, and their covariance according to the model.

    error : (n, c) along, across (m), and yaw (rad) if the truth has headings, in the frame of the window's end
    covariance : (n, c, c) predicted by the model, truth noise included
    shared : (n, c, m) root of the part of the covariance that is common to windows, or None
    """

    error: Array
    covariance: Array
    shared: Array | None = None

    def __len__(self) -> int:
        return len(self.error)

    @property
    def spectrum(self) -> Array:
        """Weights (n c,) of independent chi-squares whose sum is the sum of NEES; all 1 if windows share no error."""
        n, c = self.error.shape
        if self.shared is None:
            return np.ones(n * c)
        root = np.linalg.solve(np.linalg.cholesky(self.covariance), self.shared)
        joint = root.reshape(n * c, -1) @ root.reshape(n * c, -1).T
        for i in range(n):
            joint[i * c : (i + 1) * c, i * c : (i + 1) * c] = np.eye(c)
        return np.maximum(np.linalg.eigvalsh(joint), 0.0)

    def channel(self, i: int) -> WindowErrors:
        """Return the errors of channel `i` alone."""
        shared = None if self.shared is None else self.shared[:, i : i + 1]
        return WindowErrors(self.error[:, i : i + 1], self.covariance[:, i : i + 1, i : i + 1], shared)

    @property
    def nees(self) -> Array:
        """Normalised estimation error squared (n,); chi-square with c degrees of freedom if the model is right."""
        solved = np.linalg.solve(self.covariance, self.error[:, :, None])[:, :, 0]
        return np.sum(solved * self.error, axis=1)

    @property
    def deviation(self) -> Array:
        """Predicted standard deviation (n, c) of each error."""
        return np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2))

    @property
    def expected(self) -> Array:
        """Predicted root mean square error (c,)."""
        return np.sqrt(np.mean(self.deviation**2, axis=0))

    @property
    def measured(self) -> Array:
        """Measured root mean square error (c,)."""
        return np.sqrt(np.mean(self.error**2, axis=0))

    def coverage(self, part: float) -> Array:
        """Return the fraction (c,) of errors inside the central interval that should contain the fraction `part`."""
        return np.mean(np.abs(self.error) <= norm.isf((1.0 - part) / 2.0) * self.deviation, axis=0)

    @property
    def crps(self) -> Array:
        """Mean continuous ranked probability score (c,), m and rad; smaller is better.

        Closed form for a normal forecast: Gneiting & Raftery, JASA 102, 2007, section 4.2.
        """
        sigma = self.deviation
        z = self.error / sigma
        score = sigma * (z * (2.0 * norm.cdf(z) - 1.0) + 2.0 * norm.pdf(z) - 1.0 / np.sqrt(np.pi))
        return np.mean(score, axis=0)


def window_errors(
    windows: Intervals,
    noise: Noise,
    truth: TruthNoise,
    steps: Increments,
    *,
    headed: bool = True,
    positions: PositionWindows | None = None,
) -> WindowErrors:
    """Return errors and predicted covariances of windows.

    steps : increments of the odometry, from which the noise law computes variances
    headed : whether the truth has measured headings; without, yaw is left out: its headings come from the odometry
    positions : for a truth of positions only, the windows with the headings estimated at their starts
    """
    count = 3 if headed else 2
    if positions is not None:
        total = positions.covariance(noise.law, noise.coefficients, steps) + positions.of_truth(truth)
        total[:, [0, 1, 2], [0, 1, 2]] += FLOOR
    else:
        total = interval_covariance(windows, windows.covariance(noise.law, noise.coefficients, steps), truth)
    return WindowErrors(windows.residual[:, :count], total[:, :count, :count])

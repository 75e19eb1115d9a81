"""Windows of fixed time or distance: errors of the odometry at their ends, and the errors that a model predicts.

They give the position error after 10 s that remains with a fitted model, and compare models by it.

Covariance of the errors at the ends of windows that start with a heading estimated from positions.

The heading at a window's start comes from aligning the odometry with the truth's positions around it, most of which are
positions and odometry of the window itself. Its error is therefore neither independent of the window's other errors nor
of one size: alignment leaves no more error than the noise of many positions and the odometry's own bends there.

With q_j the odometry's positions aligned around the start s, u_j = q_j - mean(q) and S = sum |u_j|^2, the error of the
estimated heading is, to first order (least squares rotation: Umeyama, IEEE PAMI 13, 1991),

    dphi = sum_j (u_j x (e_j - n_j)) / S,

with e_j the truth's error at j, n_j that of the odometry from s to j. The error at the window's end, in the odometry's
axes and with d = q_end - q_s, is n_end - e_end + e_s + dphi J d. Both are sums over independent errors of steps and of
positions, so that the covariance follows exactly.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.stats import norm

from odomcorrupt.geometry.se2 import between, rotate
from odomcorrupt.geometry.trajectory import distance_along
from odomcorrupt.model.noise_laws import variances
from odomcorrupt.study.estimate.intervals import cut_at, intervals_between
from odomcorrupt.study.estimate.truth_bias import gyro_roots
from odomcorrupt.study.io.headings import alignment, with_recomputed_headings

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array, Increments
    from odomcorrupt.model.motion_model import TruthNoise
    from odomcorrupt.model.noise_laws import Coefficients, Law, Variances
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.io.recording import Recording

WINDOW_S = 10.0


def time_windows(recording: Recording, length_s: float = WINDOW_S, phase: float = 0.0) -> Intervals:
    """Return non-overlapping complete windows of a fixed duration, each started at the truth pose.

    phase : offset of the first window, as a fraction of a window's length
    """
    return intervals_between(recording, *_time_ends(recording, length_s, phase))


def _time_ends(recording: Recording, length_s: float, phase: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return indices of truth samples at which windows begin and end, and of the complete windows between them.

    A window begins where the one before ends, on one grid, or at the first sample from which one is complete, to a
    tenth.
    """
    odo_s, truth_s = recording.odometry_s, recording.truth_s
    first_s = odo_s[0] + phase * length_s
    usable = np.flatnonzero(recording.truth.known & (truth_s >= first_s) & (truth_s <= odo_s[-1]))
    usable_s = truth_s[usable]
    ends = np.minimum(np.searchsorted(usable_s, usable_s + length_s - 1e-9), len(usable_s) - 1)
    starts = np.flatnonzero(np.abs(usable_s[ends] - usable_s - length_s) < 0.1 * length_s)
    picked, complete = list[int](), list[int]()
    at, grid_s = -1, 0.0
    for begin in starts.tolist():
        if begin < at:
            continue
        if begin > at:
            picked.append(begin)
            grid_s = usable_s[begin]
        grid_s += length_s
        at = min(int(np.searchsorted(usable_s, grid_s - 1e-9)), len(usable_s) - 1)
        complete.append(len(picked) - 1)
        picked.append(at)
    return usable[picked or slice(1)], np.array(complete, dtype=np.int64)


def distance_windows(recording: Recording, length_m: float, phase: float = 0.0) -> Intervals:
    """Return non-overlapping windows of a fixed path length, measured by the odometry, each started at the truth pose.

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


def joint_rmse(windows: Iterable[Intervals]) -> float:
    """Return the root mean square position error (m) at the ends of several recordings' windows; NaN if none."""
    misses = [w.odometry_step[:, :2] - w.truth_step[:, :2] for w in windows if len(w)]
    return float(np.sqrt(np.mean(np.sum(np.concatenate(misses) ** 2, axis=1)))) if misses else float("nan")


def drift_of(recordings: Sequence[Recording], length_s: float = WINDOW_S) -> Drift:
    """Return the position errors at the ends of windows, for five phases: a steadier estimate than one phase."""
    squared = []
    for phase in np.arange(5) / 5.0:
        misses = []
        for recording in recordings:  # as in `time_windows`, but only the end poses are computed
            picked, first = _time_ends(recording, length_s, phase)
            truth_xyt, last = recording.truth.xyt[picked], first + 1
            odometry_xyt = recording.odometry.at(recording.truth_s[picked], recording.origin_ns)
            misses.append(between(odometry_xyt[first], odometry_xyt[last]) - between(truth_xyt[first], truth_xyt[last]))
        squared.append(np.concatenate([np.sum(own[:, :2] ** 2, axis=1) for own in misses]))
    return Drift(tuple(squared))


@dataclass(frozen=True, slots=True)
class WindowErrors:
    """Errors (odometry minus truth) at the ends of n windows, and their covariance according to the model.

    error : (n, c) along, across (m), and yaw (rad) if the truth has headings, in the frame of the window's end
    covariance : (n, c, c) predicted by the model, truth noise included
    """

    error: Array
    covariance: Array

    def __len__(self) -> int:
        return len(self.error)

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


class _Window(NamedTuple):
    """Sensitivity of the error at one window's end, in the odometry's axes.

    steps : the odometry's steps that matter
    shift : (m, 2, 2) of each step's position error; turn : (m, 2) of its heading error
    own : (2, 2) summed squares for a unit position noise of the truth
    """

    steps: slice
    shift: Array
    turn: Array
    own: Array


class PositionWindows(NamedTuple):
    """Sensitivities of n windows of a truth of positions to the errors of odometry and truth.

    source, share : (m,) the odometry's increment that contains each step between truth samples, and its part of it
    seconds : (m,) duration of each step
    axis : (m, 2) the step's forward axis, in the odometry's axes
    end_rad : (n,) the odometry's heading at the ends of windows
    level : factor on the deviations of the truth's errors
    """

    windows: tuple[_Window, ...]
    source: NDArray[np.int64]
    share: Array
    seconds: Array
    axis: Array
    end_rad: Array
    level: float

    def covariance(self, law: Law, k: Coefficients, steps: Increments) -> Array:
        """Return the covariance (n, 3, 3) of the errors due to a noise law on the increments; yaw left 0."""
        total = self.spread(law, variances(law, k, steps), steps)
        if not k.rot_time:
            return total
        found = [(w.turn * self.seconds[w.steps, None]).T @ w.turn for w in self.windows]
        return total + k.rot_time**2 * self._at_ends(found)

    def spread(self, law: Law, v: Variances, steps: Increments) -> Array:
        """Return the covariance (n, 3, 3) of the errors due to variances of the odometry's increments; yaw left 0."""
        turned, trans, across = (part[self.source] * self.share for part in (v.rot1 + v.rot2, v.trans, v.across))
        axis = self.axis
        if law.along_travel:
            axis = rotate(axis, np.arctan2(steps.dl_m, steps.ds_m)[self.source])
        side = _quarter(axis)
        found = []
        for window in self.windows:
            pairs = [(turned, window.turn)]
            pairs += [
                (weight, np.einsum("kij,kj->ki", window.shift, way[window.steps]))
                for weight, way in ((trans, axis), (across, side))
            ]
            found.append(np.sum([(row * weight[window.steps, None]).T @ row for weight, row in pairs], axis=0))
        return self._at_ends(found)

    def of_truth(self, truth: TruthNoise) -> Array:
        """Return the covariance (n, 3, 3) of the errors due to the noise of the truth's positions; yaw left 0."""
        found = []
        for window in self.windows:
            walk = np.einsum("k,kij,klj->il", self.seconds[window.steps], window.shift, window.shift)
            found.append(self.level**2 * (truth.xy_m**2 * window.own + truth.random_walk**2 * walk))
        return self._at_ends(found)

    def _at_ends(self, found: list[Array]) -> Array:
        """Return covariances (n, 3, 3) in the frames of the windows' ends."""
        c, s = np.cos(self.end_rad), np.sin(self.end_rad)
        turn = np.stack((np.stack((c, s), axis=1), np.stack((-s, c), axis=1)), axis=1)
        total = np.zeros((len(found), 3, 3))
        total[:, :2, :2] = turn @ np.array(found).reshape(-1, 2, 2) @ np.swapaxes(turn, 1, 2)
        return total


def position_windows(recording: Recording, windows: Intervals) -> PositionWindows:
    """Return the sensitivities of windows of a recording whose truth has positions only."""
    truth_s, around = recording.truth_s, alignment(recording)
    samples, known = np.flatnonzero(around.inside), np.flatnonzero(around.known & around.inside)
    cut = cut_at(recording.odometry, recording.odometry_s, truth_s[samples], recording.origin_ns)
    odo_s = recording.odometry_s
    source = np.clip(cut.source[:-1], 0, len(odo_s) - 2)
    xy, yaw, at = cut.xyt[:, :2], np.unwrap(cut.xyt[:, 2]), cut.at_node
    middle, heading = (xy[1:] + xy[:-1]) / 2.0, (yaw[1:] + yaw[:-1]) / 2.0
    start, end = (np.searchsorted(truth_s[samples], s - 1e-9) for s in (windows.start_s, windows.end_s))
    found = []
    for s, e in zip(start.tolist(), end.tolist(), strict=True):
        # an interpolated heading has about the error of the nearest one that was aligned
        by = known[np.argmin(np.abs(truth_s[known] - truth_s[samples[s]]))]
        first, last = np.searchsorted(samples, (around.first[by], around.last[by]))
        low, high = min(first, s), max(last - 1, e)
        steps = slice(int(at[low]), int(at[high]))
        q = xy[at[low : high + 1]]
        there = (np.arange(low, high + 1) >= first) & (np.arange(low, high + 1) < last)
        u = (q - np.array([around.mean_q[by].real, around.mean_q[by].imag])) * there[:, None] / around.spread_q[by]
        # sums over the samples after each step: of u, and of u . q
        after = np.searchsorted(at, np.arange(steps.start, steps.stop), side="right") - low
        later, product = (np.cumsum(x[::-1], axis=0)[::-1] for x in (u, np.sum(u * q, axis=1)))
        ahead = product[after] - np.sum(later[after] * middle[steps], axis=1)
        index = np.arange(steps.start, steps.stop)
        within = ((index >= at[s]) & (index < at[e])).astype(np.float64)
        aside = _quarter(xy[at[e]] - xy[at[s]])
        shift = within[:, None, None] * np.eye(2) - aside[:, None] * _quarter(later[after])[:, None, :]
        turn = within[:, None] * _quarter(xy[at[e]] - middle[steps])
        turn -= (ahead - (index < at[s]))[:, None] * aside
        by_sample = aside[None, :, None] * _quarter(u)[:, None, :]
        by_sample[s - low] += np.eye(2)
        by_sample[e - low] -= np.eye(2)
        found.append(_Window(steps, shift, turn, np.einsum("kij,klj->il", by_sample, by_sample)))
    return PositionWindows(
        windows=tuple(found),
        source=source,
        share=np.diff(cut.t_s) / (odo_s[source + 1] - odo_s[source]),
        seconds=np.diff(cut.t_s),
        axis=np.stack((np.cos(heading), np.sin(heading)), axis=1),
        end_rad=yaw[at[end]],
        level=recording.truth_level[0],
    )


def _quarter(xy: Array) -> Array:
    """Return vectors (..., 2) turned by +90 degrees."""
    return np.stack((-xy[..., 1], xy[..., 0]), axis=-1)


class Drift(NamedTuple):
    """Squared position errors after a time: one array (n,) of windows in m^2 for each of five phases."""

    squared: tuple[Array, ...]

    @property
    def rmse(self) -> float:
        """Root mean square of the errors, m; NaN if there is no complete window."""
        together = np.concatenate(self.squared)
        return float(np.sqrt(np.mean(together))) if len(together) else float("nan")

    def worse_than(self, other: Drift, *, factor: float, plain: float, errors: float) -> bool:
        """Return whether the drift is larger than another model's on the same recordings, by more than chance.

        In a recording of a minute, with few windows, even the true cause may increase the error of some.

        factor : ratio of the RMS errors that is always allowed
        plain : ratio that is allowed if the paired windows differ by less than `errors` standard errors
        errors : number of standard errors of the mean paired difference that counts as significant
        """
        if not self.rmse > factor * other.rmse:
            return False
        pairs = [(a, b) for a, b in zip(self.squared, other.squared, strict=True) if len(a) == len(b) > 1]
        if self.rmse > plain * other.rmse or len(pairs) < len(self.squared):
            return True
        more = [a - b for a, b in pairs]
        # phases share their data: the mean of their standard errors, as of one phase
        deviation = np.mean([np.std(d, ddof=1) / np.sqrt(len(d)) for d in more])
        return bool(np.mean([np.mean(d) for d in more]) > errors * deviation)


def with_gyros_corrected(recordings: Sequence[Recording], fitted: Fit) -> list[Recording]:
    """Return recordings with the biases that a fit to them estimates removed from those truths that are gyros."""
    if all(recording.positioned for recording in recordings):
        return list(recordings)
    intervals, roots, noise = fitted.problem.intervals, gyro_roots(fitted.problem), fitted.noise
    # posterior mean (K,) of the turn, rad, that a bias takes from the truth of each interval
    turns = (roots @ (noise.whitener.whiten(roots).T @ noise.innovations))[:, 2]
    found = list(recordings)
    for i, recording in enumerate(recordings):
        own, truth = fitted.problem.run == i, recording.truth
        if recording.positioned or not own.any():
            continue
        ends_s = np.append(intervals.start_s[own][:1], intervals.end_s[own])
        more = np.interp(recording.truth_s, ends_s, np.append(0.0, np.cumsum(turns[own])))
        steps = rotate(np.diff(truth.xyt[:, :2], axis=0), 0.5 * (more[1:] + more[:-1]))
        xy = truth.xyt[0, :2] + np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0)))
        found[i] = replace(recording, truth=replace(truth, xyt=np.column_stack((xy, truth.xyt[:, 2] + more))))
    return found


def ten_second_error(fitted: Fit, length_s: float = WINDOW_S) -> float:
    """Return the root mean square position error (m) after 10 s, or `length_s`, on the fitted recordings themselves."""
    return drift_of([with_recomputed_headings(recording) for recording in fitted.problem.left], length_s).rmse

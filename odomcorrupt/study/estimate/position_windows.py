"""Covariance of the errors at the ends of windows that start with a heading estimated from positions.

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

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.model.noise_laws import variances
from odomcorrupt.study.estimate.intervals import cut_at
from odomcorrupt.study.io.headings import alignment

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array, Increments
    from odomcorrupt.model.motion_model import TruthNoise
    from odomcorrupt.model.noise_laws import Coefficients, Law, Variances
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.io.recording import Recording


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
            bearing = np.arctan2(steps.dl_m, steps.ds_m)[self.source]
            c, s = np.cos(bearing), np.sin(bearing)
            axis = np.stack((c * axis[:, 0] - s * axis[:, 1], s * axis[:, 0] + c * axis[:, 1]), axis=1)
        side = np.stack((-axis[:, 1], axis[:, 0]), axis=1)
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

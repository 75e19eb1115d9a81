"""Headings for a truth of positions only: linearisation points, not measurements.

A few metres of the odometry's path around each truth sample are aligned with the truth's positions. These headings
depend on the odometry, so the likelihood gives them a variance of `UNKNOWN_RAD` squared, practically flat within the
range of the linearisation. Windows start with a heading of each model's corrected odometry, so that bends of the
uncorrected one do not count as errors of the model; its error depends on the window's positions, see
`position_windows`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.geometry.trajectory import Trajectory, distance_along

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Recording

UNKNOWN_RAD = 0.5
_REACH_M = 4.0  # travel before and after a sample that is aligned, and two intervals of fast motion at least
_POOR = 10.0
"""Ratio of a heading's standard error to the usual one above which the heading is interpolated from other samples."""


def with_headings(recording: Recording) -> Recording:
    """Return the recording with estimated headings and their error, if its truth has no headings."""
    return _headed(recording) if np.isnan(recording.truth.xyt[:, 2]).all() else recording


def with_recomputed_headings(recording: Recording) -> Recording:
    """Return the recording with headings re-estimated from its present odometry, for a truth of positions only."""
    return recording if recording.heading_error_rad is None else _headed(recording)


class Alignment(NamedTuple):
    """Odometry and truth positions around each of t truth samples, from which its heading is estimated.

    q, p : (t,) complex positions of odometry and truth at the samples, 0 outside the odometry's time
    inside : (t,) whether a sample is within the odometry's time
    first, last : (t,) the samples first, ..., last - 1 are aligned
    mean_q, spread_q : (t,) mean and sum of squared deviations of the aligned q
    known : (t,) whether the aligned positions determine a heading; elsewhere it is interpolated
    """

    q: Array
    p: Array
    inside: NDArray[np.bool_]
    first: NDArray[np.int64]
    last: NDArray[np.int64]
    mean_q: Array
    spread_q: Array
    known: NDArray[np.bool_]

    def sums(self, x: Array) -> Array:
        """Return the sum (t,) of values (t,) over the samples aligned around each one."""
        total = np.concatenate(([0.0], np.cumsum(x)))
        return total[self.last] - total[self.first]


def _odometry_at_truth(recording: Recording) -> Array:
    """Return the odometry's poses (t, 3) at the truth's samples; its first or last pose outside its time."""
    first_s, last_s = recording.odometry_s[[0, -1]]
    return recording.odometry.at(np.clip(recording.truth_s, first_s, last_s), recording.origin_ns)


def alignment(recording: Recording) -> Alignment:
    """Return the positions aligned around each truth sample."""
    odometry = _odometry_at_truth(recording)
    truth = recording.truth
    inside = recording.within_odometry
    q = (odometry[:, 0] + 1j * odometry[:, 1]) * inside
    p = (truth.xyt[:, 0] - truth.xyt[0, 0] + 1j * (truth.xyt[:, 1] - truth.xyt[0, 1])) * inside
    travelled = distance_along(odometry)
    reach_m = max(_REACH_M, 2.0 * float(np.percentile(np.diff(travelled), 90.0))) if len(travelled) > 1 else _REACH_M
    first = np.searchsorted(travelled, travelled - reach_m, side="left")
    last = np.searchsorted(travelled, travelled + reach_m, side="right")
    found = Alignment(q, p, inside, first, last, q, travelled, inside)
    count = np.maximum(found.sums(inside.astype(np.float64)), 1.0)
    mean = found.sums(q) / count
    spread = found.sums(np.abs(q) ** 2) - count * np.abs(mean) ** 2
    # beside outages a window may have too few positions: there the rotation is interpolated between known ones
    known = spread >= np.median(spread[inside]) / _POOR**2 if inside.any() else np.ones(len(q), dtype=bool)
    return found._replace(mean_q=mean, spread_q=spread, known=known)


def _headed(recording: Recording) -> Recording:
    truth, truth_s = recording.truth, recording.truth_s
    a = alignment(recording)
    count = np.maximum(a.sums(a.inside.astype(np.float64)), 1.0)
    mean_p = a.sums(a.p) / count
    cross = a.sums(np.conj(a.q) * a.p) - count * np.conj(a.mean_q) * mean_p
    spread_p = a.sums(np.abs(a.p) ** 2) - count * np.abs(mean_p) ** 2
    turned = np.interp(truth_s, truth_s[a.known], np.unwrap(np.angle(cross[a.known])))
    heading = _odometry_at_truth(recording)[:, 2] + turned
    unexplained = np.maximum(spread_p + a.spread_q - 2.0 * np.abs(cross), 0.0)
    error = float(np.sqrt(np.median(unexplained / np.maximum(a.spread_q, 1e-9))))
    xyt = np.concatenate((truth.xyt[:, :2], heading[:, None]), axis=1)
    return replace(recording, truth=Trajectory(truth.stamps_ns, xyt), heading_error_rad=max(error, 1e-3))

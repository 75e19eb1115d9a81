"""Headings for a truth of positions only: linearisation points, not measurements.

A few metres of the odometry's path around each truth sample are aligned with the truth's positions; the rotation gives
the heading there. These headings depend on the odometry, so the likelihood treats them as unknown: their variance is
`UNKNOWN_RAD` squared, practically flat within the range of the linearisation. Only the positions carry information.

Drift errors at the end of a window also need an initial heading. For each model it comes from that model's corrected
odometry aligned with the positions; bends of the uncorrected odometry then do not count as errors of the model.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.trajectory import Trajectory

if TYPE_CHECKING:
    from odomcorrupt.study.io.recording import Recording

UNKNOWN_RAD = 0.5
_REACH_M = 4.0  # travel before and after a sample that is aligned
_POOR = 10.0
"""Ratio of a heading's standard error to the usual one above which the heading is interpolated from other samples."""


def with_headings(recording: Recording) -> Recording:
    """Return the recording with estimated headings and their error, if its truth has no headings."""
    return _headed(recording) if np.isnan(recording.truth.xyt[:, 2]).all() else recording


def with_recomputed_headings(recording: Recording) -> Recording:
    """Return the recording with headings re-estimated from its present odometry, for a truth of positions only."""
    return recording if recording.heading_error_rad is None else _headed(recording)


def _headed(recording: Recording) -> Recording:
    truth = recording.truth
    odo_s, truth_s = recording.odometry_s, truth.seconds_since(recording.origin_ns)
    inside = (truth_s >= odo_s[0]) & (truth_s <= odo_s[-1])
    odometry = recording.odometry.at(np.clip(truth_s, odo_s[0], odo_s[-1]), recording.origin_ns)
    q = (odometry[:, 0] + 1j * odometry[:, 1]) * inside
    p = (truth.xyt[:, 0] - truth.xyt[0, 0] + 1j * (truth.xyt[:, 1] - truth.xyt[0, 1])) * inside
    travelled = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(odometry[:, :2], axis=0), axis=1))))
    first = np.searchsorted(travelled, travelled - _REACH_M, side="left")
    last = np.searchsorted(travelled, travelled + _REACH_M, side="right")

    def window_sum(x: np.ndarray) -> np.ndarray:
        total = np.concatenate(([0.0], np.cumsum(x)))
        return total[last] - total[first]

    count = np.maximum(window_sum(inside.astype(np.float64)), 1.0)
    mean_q, mean_p = window_sum(q) / count, window_sum(p) / count
    cross = window_sum(np.conj(q) * p) - count * np.conj(mean_q) * mean_p
    spread_q = window_sum(np.abs(q) ** 2) - count * np.abs(mean_q) ** 2
    spread_p = window_sum(np.abs(p) ** 2) - count * np.abs(mean_p) ** 2
    # beside outages a window may have too few positions: there the rotation is interpolated between known ones
    known = spread_q >= np.median(spread_q[inside]) / _POOR**2 if inside.any() else np.ones(len(q), dtype=bool)
    heading = odometry[:, 2] + np.interp(truth_s, truth_s[known], np.unwrap(np.angle(cross[known])))
    left_over = np.maximum(spread_p + spread_q - 2.0 * np.abs(cross), 0.0)
    error = float(np.sqrt(np.median(left_over / np.maximum(spread_q, 1e-9))))
    xyt = np.concatenate((truth.xyt[:, :2], heading[:, None]), axis=1)
    return replace(recording, truth=Trajectory(truth.stamps_ns, xyt), heading_error_rad=max(error, 1e-3))

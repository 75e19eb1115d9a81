"""Headings for a truth that has only positions: a place to linearise at, never a measurement.

Around every truth sample a few metres of the odometry's path are turned onto the truth's positions; the turn gives the
heading there. Because the odometry had a hand in it, the likelihood treats these headings as unknown (their variance is
`UNKNOWN_RAD` squared, flat over what a linearisation can bear), and only the positions carry information.

Errors at the end of a window need a heading to start from, too. There each model is given the headings that its own
odometry, with its effects taken out, has when laid onto the positions: a model is not blamed for what the uncorrected
odometry bends in the headings.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.io.recording import Trajectory

if TYPE_CHECKING:
    from odomcorrupt.study.io.recording import Recording

__all__ = ["UNKNOWN_RAD", "with_headings", "with_recomputed_headings"]

UNKNOWN_RAD = 0.5
_REACH_M = 4.0


def with_headings(recording: Recording) -> Recording:
    """Return the recording with headings for its truth where it has none, and how far off they may be."""
    return _headed(recording) if np.isnan(recording.truth.xyt[:, 2]).all() else recording


def with_recomputed_headings(recording: Recording) -> Recording:
    """Return the recording with headings recomputed from its present odometry, for a truth of positions alone."""
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
    heading = odometry[:, 2] + np.unwrap(np.angle(cross))
    left_over = np.maximum(spread_p + spread_q - 2.0 * np.abs(cross), 0.0)
    error = float(np.sqrt(np.median(left_over / np.maximum(spread_q, 1e-9))))
    xyt = np.concatenate((truth.xyt[:, :2], heading[:, None]), axis=1)
    return replace(recording, truth=Trajectory(truth.stamps_ns, xyt), heading_error_rad=max(error, 1e-3))

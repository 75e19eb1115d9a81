"""Detection and removal of the steps in odometry of a filter that fuses external poses.

Between two pose updates the output of such a filter (robot_localization with an absolute pose) follows wheels and gyro;
at an update it steps. Wheels never step sideways: their sideways speed is zero, or changes slowly because of inertia if
the robot drives sideways. Without the steps the errors of wheels and gyro accumulate as in free odometry, so that a
model of them can be learned and corrected.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.corruption.path import JUMP_MIN_S, JUMP_SPEED
from odomcorrupt.geometry.increments import Increments, accumulate, increments

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

_DETECTION_MEDIANS = 10.0
"""Detection threshold as a multiple of the median sideways step: 6.7 standard deviations of normal ones."""
_LEAST_M = 2e-5
"""Least detection threshold, m: positions are written in micrometres, and single precision resolves 1e-6 at 10 m."""


_VISIBLE_RATIO = 5.0
"""Least ratio of the median detected step to the threshold: of normally distributed steps one in ten is hidden then."""


class PoseCorrections(NamedTuple):
    """Number of filter steps in odometry, and the change (n, 3) of its poses by their removal, m and rad."""

    steps: int
    error_xyt: Array


def pose_corrections(t_s: Array, xyt: Array) -> PoseCorrections:
    """Return the sudden sideways steps of odometry and the change of the poses without them.

    The motion over a removed step is interpolated between its neighbours. Pose resets are kept, as in any correction.
    If steps are not much larger than the usual sideways motion, most of them are hidden, and none is removed.

    t_s : (n,) ascending times, seconds
    xyt : (n, 3) poses in the odom frame, metres and radians
    """
    steps, dt_s = increments(xyt), np.diff(t_s)
    moved = steps.rows
    driven = (dt_s > 0.0) & (np.hypot(moved[:, 0], moved[:, 1]) <= JUMP_SPEED * np.maximum(dt_s, JUMP_MIN_S))
    rows = np.flatnonzero(driven)
    if len(rows) < 3:
        return PoseCorrections(0, np.zeros_like(xyt))
    rate = moved[rows] / dt_s[rows, None]
    sideways = np.zeros(len(rows))
    sideways[1:-1] = np.abs(rate[1:-1, 1] - 0.5 * (rate[:-2, 1] + rate[2:, 1])) * dt_s[rows[1:-1]]
    beside = np.maximum(np.append(0.0, sideways[:-1]), np.append(sideways[1:], 0.0))
    least_m = max(_LEAST_M, _DETECTION_MEDIANS * float(np.median(sideways)))
    # a step raises the values of its two neighbours by half of its size
    sudden = (sideways > least_m) & (sideways >= beside)
    if not sudden.any() or np.median(sideways[sudden]) < _VISIBLE_RATIO * least_m:
        return PoseCorrections(0, np.zeros_like(xyt))
    middle_s = 0.5 * (t_s[:-1] + t_s[1:])[rows]
    for column in range(3):
        rate[sudden, column] = np.interp(middle_s[sudden], middle_s[~sudden], rate[~sudden, column])
    moved[rows[sudden]] = rate[sudden] * dt_s[rows[sudden], None]
    free = accumulate(xyt[0], Increments.of_rows(moved))
    return PoseCorrections(int(sudden.sum()), free - np.column_stack((xyt[:, :2], np.unwrap(xyt[:, 2]))))

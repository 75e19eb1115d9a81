"""Steps by which a filter moves its odometry towards poses that it is given, found in the odometry and taken out.

Between two updates the output of such a filter (robot_localization that fuses an absolute pose) is what its wheels and
gyro say; at an update it steps. Wheels never step sideways: between two messages their sideways speed is nothing, or
that of a robot that drives sideways, which has inertia. What lies between the steps is free odometry, in which the
errors of wheels and gyro pile up as ever, and a model of these can be learned and taken out.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.corruption.path import JUMP_MIN_S, JUMP_SPEED
from odomcorrupt.geometry.increments import Increments, accumulate, increments

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

__all__ = ["PoseCorrections", "pose_corrections"]

_STANDS_OUT = 10.0
"""Medians by which a sideways step stands out of the others: 6.7 standard deviations of normal ones."""
_LEAST_M = 2e-5
"""Least step that is one: positions are written in micrometres, and single precision holds 1e-6 at 10 m."""


_HIDDEN = 5.0
"""How many times the least step the median one is where hardly any stays hidden: of normal ones, one in ten."""


class PoseCorrections(NamedTuple):
    """How many steps of a filter odometry has, and by how much its poses (n, 3) move where they are taken out."""

    steps: int
    error_xyt: Array


def pose_corrections(t_s: Array, xyt: Array) -> PoseCorrections:
    """Return the sudden sideways steps of odometry; without them the robot moves over each as before and after it.

    Poses that were set (resets) are left as they are, as everywhere in a correction. Where steps are no larger than
    what moves the odometry sideways all the time, most of them are hidden, and none is taken out.

    Parameters
    ----------
    t_s : (n,)
        Ascending times, seconds.
    xyt : (n, 3)
        Poses in the odom frame, metres and radians.
    """
    steps, dt_s = increments(xyt), np.diff(t_s)
    moved = np.stack((steps.ds_m, steps.dl_m, steps.dtheta_rad), axis=1)
    driven = (dt_s > 0.0) & (np.hypot(moved[:, 0], moved[:, 1]) <= JUMP_SPEED * np.maximum(dt_s, JUMP_MIN_S))
    rows = np.flatnonzero(driven)
    if len(rows) < 3:
        return PoseCorrections(0, np.zeros_like(xyt))
    rate = moved[rows] / dt_s[rows, None]
    sideways = np.zeros(len(rows))
    sideways[1:-1] = np.abs(rate[1:-1, 1] - 0.5 * (rate[:-2, 1] + rate[2:, 1])) * dt_s[rows[1:-1]]
    beside = np.maximum(np.append(0.0, sideways[:-1]), np.append(sideways[1:], 0.0))
    least_m = max(_LEAST_M, _STANDS_OUT * float(np.median(sideways)))
    # beside itself, a step shows half as large
    sudden = (sideways > least_m) & (sideways >= beside)
    if not sudden.any() or np.median(sideways[sudden]) < _HIDDEN * least_m:
        return PoseCorrections(0, np.zeros_like(xyt))
    middle_s = 0.5 * (t_s[:-1] + t_s[1:])[rows]
    for column in range(3):
        rate[sudden, column] = np.interp(middle_s[sudden], middle_s[~sudden], rate[~sudden, column])
    moved[rows[sudden]] = rate[sudden] * dt_s[rows[sudden], None]
    free = accumulate(xyt[0], Increments(*np.ascontiguousarray(moved.T)))
    return PoseCorrections(int(sudden.sum()), free - np.column_stack((xyt[:, :2], np.unwrap(xyt[:, 2]))))

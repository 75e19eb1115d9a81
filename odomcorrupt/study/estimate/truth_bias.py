"""What a truth by scan matching may have wrong in common: the laser's scale, and small distortions of its map.

Each is a random factor with a known deviation, so that it widens the errors of whatever it looks like and lowers the
evidence for it, as a prior would. A truth of which nothing of the kind is known has none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import rotate

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.problem import Problem

__all__ = ["bias_roots", "has_bias"]

SPEED_BIAS = 1e-3
"""Deviation of a scale error of matches that grows with speed, per m/s: motion within a sweep."""
TURN_BIAS = 1e-3
"""Deviation of a scale error of turns, and of one that grows with speed, per m/s: 4e-4 was seen where nothing else
could err."""
LOCAL_BIAS = 1e-3
"""Deviation of the scale of a part of the map: keyframes half a metre apart are placed to a millimetre or two."""
CELL_M = 2.0
_MOST_CELLS = 150


def has_bias(problem: Problem) -> bool:
    """Whether any truth of a problem may have something wrong in common."""
    return any(r.truth_scale_error > 0.0 or r.truth.covariance is not None for r in problem.recordings)


def bias_roots(problem: Problem) -> Array:
    """Return columns (K, 3, m) whose independent standard normal factors are what a truth has wrong in common.

    One factor for all recordings where it is the instrument's, one for each place where it is the map's.
    """
    nodes, runs = problem.nodes, problem.recordings
    scale = np.array([r.truth_scale_error for r in runs])[problem.run]
    matched = np.array([float(r.truth.covariance is not None) for r in runs])[problem.run]
    step = nodes.truth_step
    along = -rotate(step[:, :2], -step[:, 2])
    speed = np.hypot(step[:, 0], step[:, 1]) / (nodes.end_s - nodes.start_s)
    columns = [_of_travel(along * weight[:, None]) for weight in (scale, SPEED_BIAS * matched * speed)]
    turn = -TURN_BIAS * matched * step[:, 2]
    columns += [np.column_stack((np.zeros((len(step), 2)), part)) for part in (turn, turn * speed)]
    cell = np.floor(nodes.truth_xyt[:, :2] / CELL_M).astype(np.int64)
    _, place, count = np.unique(
        np.column_stack((problem.run.astype(np.int64), cell)), axis=0, return_inverse=True, return_counts=True
    )
    place = place.ravel()
    for k in np.argsort(count)[::-1][:_MOST_CELLS]:
        here = (place == k) * matched
        if here.any():
            columns.append(_of_travel(LOCAL_BIAS * along * here[:, None]))
    return np.stack(columns, axis=2)


def _of_travel(xy: Array) -> Array:
    return np.column_stack((xy, np.zeros(len(xy))))

"""What a sensor on the robot as a truth may have wrong in common: a laser's scale and map, a gyro's gain and bias.

Each is a random factor with a known deviation, so that it widens the errors of whatever it looks like and lowers the
evidence for it, as a prior would. A truth of which nothing of the kind is known has none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.noise_likelihood import NoiseFit
    from odomcorrupt.study.estimate.problem import Problem

__all__ = ["SHARED", "bias_roots", "has_bias", "scale_errors"]

SPEED_BIAS = 1e-3
"""Deviation of a scale error of matches that grows with speed, per m/s: motion within a sweep."""
TURN_BIAS = 1e-3
"""Deviation of a scale error of turns, and of one that grows with speed, per m/s: 4e-4 was seen where nothing else
could err."""
LAG_BIAS_S, GYRO_LAG_S = 1e-3, 0.01
"""Deviation of a lag of turns behind travel, seconds: of sweeps, below 0.7 ms in simulated drives, and of a gyro as
the truth, which has a filter."""
LOCAL_BIAS = 1e-3
"""Deviation of the scale of a part of the map: keyframes half a metre apart are placed to a millimetre or two."""
CELL_M = 2.0
GYRO_WANDER_RADPS, _WANDER_S = 1.5e-4, 30.0
"""Deviation of a gyro's bias from its mean over stretches of so many seconds: 0.009 deg/s, as MEMS have it."""
SHARED = 6
"""So many of the columns, the first ones, are of the instrument: a fit of the noise leaves these free."""
_MOST_CELLS = 150


def has_bias(problem: Problem) -> bool:
    """Whether any truth of a problem may have something wrong in common."""
    return any(r.truth_scale_error > 0.0 or r.turn_scale_error > 0.0 or r.matched for r in problem.recordings)


def bias_roots(problem: Problem) -> Array:
    """Return columns (K, 3, m) whose independent standard normal factors are what a truth has wrong in common.

    One factor for all recordings where it is the instrument's, one for each place where it is the map's.
    """
    nodes, runs = problem.nodes, problem.recordings
    scale = np.array([r.truth_scale_error for r in runs])[problem.run]
    matched = np.array([float(r.matched) for r in runs])[problem.run]
    along, turn, speed = _smooth_motion(problem)
    columns = [_of_travel(along * weight[:, None]) for weight in (scale, SPEED_BIAS * matched * speed)]
    scale_of_turns = np.array([r.turn_scale_error for r in runs])[problem.run]
    columns += [_of_turn(np.hypot(TURN_BIAS * matched, scale_of_turns) * turn)]
    columns += [_of_turn(TURN_BIAS * matched * turn * speed)]
    duration = nodes.end_s - nodes.start_s
    columns += [_of_turn(-np.array([r.turn_bias_error for r in runs])[problem.run] * duration)]
    by_gyro = np.array([float(not r.positioned) for r in runs])[problem.run]
    kind = registry().get("channel_lag")
    if kind is not None:
        lag_s = np.maximum(LAG_BIAS_S * matched, GYRO_LAG_S * by_gyro)
        columns += [lag_s[:, None] * part for part in np.moveaxis(problem.columns(kind()), 2, 0)]
    columns += [_of_turn(-GYRO_WANDER_RADPS * by_gyro * part) for part in _stretches(problem, duration)]
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


def scale_errors(problem: Problem, noise: NoiseFit) -> Array:
    """Return the posterior mean (R,) of the scale error of each recording's truth: positive where it is too long."""
    factor = noise.whitener.whiten(bias_roots(problem)[:, :, :1]).T @ noise.innovations
    scales: Array = np.array([r.truth_scale_error for r in problem.recordings]) * factor
    return scales


def _smooth_motion(problem: Problem) -> tuple[Array, Array, Array]:
    """Return what a truth says too little of travel (K, 2) and of turns (K,) per unit of scale error, and speeds (K,).

    They are made of the smooth motion that regressors are made of, never of the truth's own steps: these hold the noise
    that is in the residual as well, and a factor of them would be estimated from that, not from a scale error.
    """
    twist = np.concatenate([np.stack((m.v, m.vy, m.omega), axis=1) * m.dt_s[:, None] for m in problem.motions])
    travel = twist * (1.0, 1.0, 0.0)
    along = -problem.nodes.column(travel)[:, :2]
    turn = -problem.nodes.column(twist * (0.0, 0.0, 1.0))[:, 2]
    return along, turn, np.hypot(along[:, 0], along[:, 1]) / (problem.nodes.end_s - problem.nodes.start_s)


def _stretches(problem: Problem, duration: Array) -> list[Array]:
    """Return the time (K,) of each interval for each stretch of a run of which a gyro is the truth, seconds."""
    if all(r.positioned for r in problem.recordings):
        return []
    blind = np.array([not r.positioned for r in problem.recordings])[problem.run]
    stretch = np.floor(problem.nodes.start_s / _WANDER_S).astype(np.int64) + 100_000 * problem.run.astype(np.int64)
    return [duration * (stretch == one) for one in np.unique(stretch[blind])[:_MOST_CELLS]]


def _of_turn(yaw: Array) -> Array:
    return np.column_stack((np.zeros((len(yaw), 2)), yaw))


def _of_travel(xy: Array) -> Array:
    return np.column_stack((xy, np.zeros(len(xy))))

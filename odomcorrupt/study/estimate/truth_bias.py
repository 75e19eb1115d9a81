"""Systematic errors of a truth from a sensor on the robot: a laser's scale and map, a gyro's gain and bias.

Each is a random factor with a known standard deviation. Like a prior, it widens the errors of parameters aliased with
it and lowers the evidence for them. A truth without known errors of this kind has no such factors.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.noise_likelihood import NoiseFit
    from odomcorrupt.study.estimate.problem import Problem

SPEED_BIAS = 1e-3
"""Standard deviation of a scale error of scan matches proportional to speed, per m/s: from motion within a sweep."""
TURN_BIAS = 1e-3
"""Standard deviation of a scale error of turns, and of one proportional to speed, per m/s: 4e-4 was measured on data
without other errors."""
LAG_BIAS_S, GYRO_LAG_S = 1e-3, 0.01
"""Standard deviation of a lag of turns behind travel, seconds: of laser sweeps (below 0.7 ms in simulated drives), and
of a gyro as the truth, which has a filter."""
LOCAL_BIAS = 1e-3
"""Standard deviation of the scale of a map cell: keyframes half a metre apart have errors of one or two millimetres."""
CELL_M = 2.0
MAP_STRAIN = 1e-3
"""Standard deviation of the stretch and of the shear of a whole map, in its axes: that of its cells."""
GYRO_WALK, _WALK_STEP_S = 1e-4, 30.0
"""Random walk of a gyro's bias, rad/s after one second (0.006 deg/s; MEMS gyros have 0.001 to 0.03, IEEE Std 952), and
duration of each bias, s."""
SHARED = 6
"""Number of leading columns that belong to the instrument; a noise fit treats them as free."""
_MOST_CELLS = 150


def has_bias(problem: Problem) -> bool:
    """Return whether the truth of any recording may have systematic errors of this kind."""
    return any(r.truth_scale_error > 0.0 or r.turn_scale_error > 0.0 or r.matched for r in problem.recordings)


def bias_roots(problem: Problem) -> Array:
    """Return columns (K, 3, m): times independent standard normal factors, they are the truth's systematic errors.

    Errors of the instrument have one factor for all recordings, errors of the map one for each cell.
    """
    intervals, runs = problem.intervals, problem.recordings
    scale = np.array([r.truth_scale_error for r in runs])[problem.run]
    matched = np.array([float(r.matched) for r in runs])[problem.run]
    along, turn, speed = _smooth_motion(problem)
    columns = [_of_travel(along * weight[:, None]) for weight in (scale, SPEED_BIAS * matched * speed)]
    scale_of_turns = np.array([r.turn_scale_error for r in runs])[problem.run]
    columns += [_of_turn(np.hypot(TURN_BIAS * matched, scale_of_turns) * turn)]
    columns += [_of_turn(TURN_BIAS * matched * turn * speed)]
    duration = intervals.end_s - intervals.start_s
    columns += [_of_turn(-np.array([r.turn_bias_error for r in runs])[problem.run] * duration)]
    by_gyro = np.array([float(not r.positioned) for r in runs])[problem.run]
    kind = registry().get("channel_lag")
    if kind is not None:
        lag_s = np.maximum(LAG_BIAS_S * matched, GYRO_LAG_S * by_gyro)
        columns += [lag_s[:, None] * part for part in np.moveaxis(problem.columns(kind()), 2, 0)]
    step_radps = GYRO_WALK * np.sqrt(_WALK_STEP_S)
    columns += [_of_turn(-step_radps * later) for later in _after_steps(problem, duration)]
    for r, run in enumerate(runs):
        if run.matched:
            own = along * (problem.run == r)[:, None]
            columns += [_of_travel(MAP_STRAIN * part) for part in _strains(problem, own)]
    cell = np.floor(intervals.truth_xyt[:, :2] / CELL_M).astype(np.int64)
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
    """Return the posterior mean (R,) of the scale error of each recording's truth; positive if it is too long."""
    factor = noise.whitener.whiten(bias_roots(problem)[:, :, :1]).T @ noise.innovations
    scales: Array = np.array([r.truth_scale_error for r in problem.recordings]) * factor
    return scales


def _smooth_motion(problem: Problem) -> tuple[Array, Array, Array]:
    """Return the residual of travel (K, 2) and turns (K,) per unit of scale error of the truth, and speeds (K,).

    They are computed from the smooth motion of the regressors, never from the truth's own steps. Those contain the same
    noise as the residual, and the estimated factor would reflect it instead of a scale error.
    """
    twist = np.concatenate([np.stack((m.v, m.vy, m.omega), axis=1) * m.dt_s[:, None] for m in problem.motions])
    travel = twist * (1.0, 1.0, 0.0)
    along = -problem.intervals.column(travel)[:, :2]
    turn = -problem.intervals.column(twist * (0.0, 0.0, 1.0))[:, 2]
    return along, turn, np.hypot(along[:, 0], along[:, 1]) / (problem.intervals.end_s - problem.intervals.start_s)


def _strains(problem: Problem, along: Array) -> tuple[Array, Array]:
    """Return the residual of travel (K, 2) per unit stretch of the map's x axis, which shortens y, and per unit shear.

    along : (K, 2) that per unit of scale error, in the axes of the robot at the end of each interval
    """
    twice = 2.0 * (problem.intervals.truth_xyt[:, 2] + problem.intervals.truth_step[:, 2])
    c, s, (x, y) = np.cos(twice), np.sin(twice), along.T
    return np.column_stack((c * x - s * y, -s * x - c * y)), np.column_stack((s * x + c * y, c * x - s * y))


def _after_steps(problem: Problem, duration: Array) -> list[Array]:
    """Return the duration (K,) of the intervals, s, after each step of the bias of each run whose truth is a gyro."""
    steps = np.floor(problem.intervals.start_s / _WALK_STEP_S).astype(np.int64)
    own = [(problem.run == i, steps[problem.run == i]) for i, r in enumerate(problem.recordings) if not r.positioned]
    after = [duration * (run & (steps >= one)) for run, mine in own for one in np.unique(mine)[1:]]
    return after[:_MOST_CELLS]


def _of_turn(yaw: Array) -> Array:
    return np.column_stack((np.zeros((len(yaw), 2)), yaw))


def _of_travel(xy: Array) -> Array:
    return np.column_stack((xy, np.zeros(len(xy))))

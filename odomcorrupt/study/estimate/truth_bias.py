"""Systematic errors of a truth from a sensor on the robot: a laser's scale and map, a gyro's gain and bias.

Each is a random factor with a known standard deviation. Like a prior, it widens the errors of parameters aliased with
it and lowers the evidence for them. A truth without known errors of this kind has no such factors.

The random walk of a gyro's bias, where a gyro is the only truth, is a variance component, estimated by restricted
maximum likelihood with a prior (Patterson & Thompson 1971, Biometrika 58, 545). Wheels at rest do not turn, so the
rests of a drive show the bias itself; in motion, the walk is what varies slowly in the difference of wheels and gyro,
beside effects of turns.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import eigh, orth

from odomcorrupt.effects import registry
from odomcorrupt.study.estimate.noise_likelihood import VarianceComponents, fit_noise
from odomcorrupt.study.estimate.problem import pose_problem

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.config import Approach
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.io.recording import Recording

SPEED_BIAS = 1e-3
"""Standard deviation of a scale error of scan matches proportional to speed, per m/s: from motion within a sweep."""
TURN_BIAS = 1e-3
"""Standard deviation of a scale error of turns, and of one proportional to speed, per m/s: 4e-4 was measured on data
without other errors."""
LAG_BIAS_S, GYRO_LAG_S = 1e-3, 0.01
"""Standard deviation of a lag of turns behind travel, seconds: of laser sweeps (below 0.7 ms in simulated drives), and
of a gyro as the truth, which has a filter."""
LOCAL_BIAS = 1e-3
"""Standard deviation of the scale of a map cell: keyframes half a metre apart have errors of one or two millimetres;
and of the stretch and the shear of the whole map, in its axes."""
CELL_M = 2.0
GYRO_BIAS, USUAL_WALK = 0.02, 1e-4
"""Standard deviation of a gyro's bias at the beginning, rad/s, which rests of the drive measure, and its random walk if
that is not estimated, rad/s/sqrt(s)."""
_WALK_STEP_S, _MOST_STEPS = 10.0, 150
"""Shortest duration between steps of that walk, s, and their largest number."""
SHARED = 5
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
    # Residuals of travel (K, 2) and turns (K,) per unit of scale error, and speeds (K,), are those of the regressors'
    # smooth motion: the truth's own steps contain the noise of the residual, which the factors would then reflect.
    twist = np.concatenate([m.twist * m.dt_s[:, None] for m in problem.motions])
    along = -intervals.column(twist * (1.0, 1.0, 0.0))[:, :2]
    turn = -intervals.column(twist * (0.0, 0.0, 1.0))[:, 2]
    speed = np.hypot(along[:, 0], along[:, 1]) / (intervals.end_s - intervals.start_s)
    columns = [_of_travel(along * weight[:, None]) for weight in (scale, SPEED_BIAS * matched * speed)]
    scale_of_turns = np.array([r.turn_scale_error for r in runs])[problem.run]
    columns += [_of_turn(np.hypot(TURN_BIAS * matched, scale_of_turns) * turn)]
    columns += [_of_turn(TURN_BIAS * matched * turn * speed)]
    by_gyro = np.array([float(not r.positioned) for r in runs])[problem.run]
    lag_s = np.maximum(LAG_BIAS_S * matched, GYRO_LAG_S * by_gyro)
    columns += [lag_s[:, None] * part for part in np.moveaxis(problem.columns(registry()["channel_lag"]()), 2, 0)]
    columns += [*np.moveaxis(gyro_roots(problem), 2, 0)]
    twice = 2.0 * (intervals.truth_xyt[:, 2] + intervals.truth_step[:, 2])
    c, s = np.cos(twice), np.sin(twice)
    for r, run in enumerate(runs):
        if run.matched:  # per unit stretch of the map's x axis, which shortens y, and per unit shear
            x, y = (along * (problem.run == r)[:, None]).T
            strains = np.column_stack((c * x - s * y, -s * x - c * y)), np.column_stack((s * x + c * y, c * x - s * y))
            columns += [_of_travel(LOCAL_BIAS * part) for part in strains]
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


def gyro_roots(problem: Problem) -> Array:
    """Return the columns (K, 3, m) of `bias_roots` that belong to the biases of gyros."""
    runs = problem.recordings
    walk = np.array([USUAL_WALK if r.turn_bias_walk is None else r.turn_bias_walk for r in runs])[problem.run]
    start, steps = bias_steps(problem)
    return np.concatenate((GYRO_BIAS * start, walk[:, None, None] * steps), axis=2)


def bias_steps(problem: Problem) -> tuple[Array, Array]:
    """Return columns of the bias of each gyro that is the truth: at the beginning, and steps of its random walk.

    The first are (K, 3, r) for a bias of 1 rad/s of each of r recordings, the others (K, 3, m) for the steps of a
    random walk of 1 rad/s/sqrt(s).
    """
    intervals = problem.intervals
    start, steps = [np.zeros((len(intervals), 0))], [np.zeros((len(intervals), 0))]
    for i in (i for i, r in enumerate(problem.recordings) if not r.positioned):
        own = problem.run == i
        turn = np.where(own, intervals.start_s - intervals.end_s, 0.0)[:, None]
        start.append(turn)
        first_s, last_s = (f(intervals.start_s[own], initial=0.0) for f in (np.min, np.max))
        step_s = max(_WALK_STEP_S, (last_s - first_s) / _MOST_STEPS)
        later = intervals.start_s[:, None] >= np.arange(first_s + step_s, last_s, step_s)
        steps.append(np.sqrt(step_s) * turn * later)
    return _of_turn(np.concatenate(start, axis=1)), _of_turn(np.concatenate(steps, axis=1))


def _of_turn(yaw: Array) -> Array:
    """Return columns (K, 3, ...) of turns (K, ...) alone."""
    return np.stack((np.zeros_like(yaw), np.zeros_like(yaw), yaw), axis=1)


def _of_travel(xy: Array) -> Array:
    return np.column_stack((xy, np.zeros(len(xy))))


_WALKS = np.geomspace(3e-6, 3e-3, 121)
_SPREAD = 1.0
"""Standard deviation of the logarithm of the level, around `USUAL_WALK`: MEMS gyros have 1e-5 to 5e-4."""
_BESIDE = ("wheelbase", "unequal_wheels", "turn_asymmetry")
"""Effects that are free during the estimate."""


def with_bias_walks(recordings: Sequence[Recording], approach: Approach) -> list[Recording]:
    """Return the recordings; those with a gyro as their truth get the random walk of its bias."""
    return [r if r.positioned else replace(r, turn_bias_walk=_walk_of(r, approach)) for r in recordings]


def _walk_of(recording: Recording, approach: Approach) -> float:
    """Return the most likely random walk of the bias of a recording's gyro, rad/s/sqrt(s)."""
    problem, kinds = pose_problem([recording], approach=approach), registry()
    start, steps = bias_steps(problem)
    effects = [problem.columns(kinds[name]()) for name in _BESIDE]
    beside = np.concatenate((*effects, bias_roots(problem)[:, :, :SHARED], start), axis=2)
    components = VarianceComponents(approach.law, problem.intervals, problem.steps)
    # with the walk free, it is not fitted as noise of each interval
    white = fit_noise(
        problem.intervals, components, np.concatenate((beside, steps), axis=2), headings=problem.headings
    ).whitener
    known = orth(white.whiten(beside))
    root, residual = (x - known @ (known.T @ x) for x in map(white.whiten, (steps, problem.intervals.residual)))
    strength, turned = eigh(root.T @ root)
    score = (turned.T @ (root.T @ residual)) ** 2
    square = _WALKS[:, None] ** 2
    nats = 0.5 * np.sum(square * score / (1.0 + square * strength) - np.log1p(square * strength), axis=1)
    nats -= 0.5 * (np.log(_WALKS / USUAL_WALK) / _SPREAD) ** 2
    return float(_WALKS[np.argmax(nats)])

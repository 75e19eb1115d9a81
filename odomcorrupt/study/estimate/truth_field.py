"""Spatially correlated errors of a localisation: repeated on every visit, with a correlation length of about a metre.

They are a Gaussian field f on the map, with covariance s^2 exp(-d^2 / (2 l^2)), plus independent errors of each pose.
A robot that circles in a room meets the same errors repeatedly. If they were treated as independent, the slope of the
field across the room would appear as an odometry scale known to a part in a thousand.

In the likelihood the field is a random effect with a low-rank root (Rasmussen & Williams 2006, section 8.3: subset of
regressors, here cells of the map).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import eigh
from scipy.optimize import minimize

from odomcorrupt.errors import FitError
from odomcorrupt.model.motion_model import TruthNoise
from odomcorrupt.study.estimate.noise_likelihood import prior_of_errors
from odomcorrupt.study.estimate.whitener import map_axes, whitener
from odomcorrupt.study.io.recording import TruthField

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.estimate.whitener import Whitener
    from odomcorrupt.study.io.recording import Recording

LENGTHS_M = (0.7, 1.2, 2.0)
"""Candidate correlation lengths of the field; a longer one would be a scale or a rotation of the whole map."""
_CELL, _MOST_CELLS = 0.5, 400
"""Cell size of the map in correlation lengths, and maximum number of cells; larger cells lose detail, not variance."""
_NOTHING = 1e-6
"""Fraction of the largest eigenvalue below which a direction of the field is dropped."""
_BOUNDS = tuple((np.log(low), np.log(high)) for low, high in ((3e-4, 1.0), (1e-4, 0.3)) * 2)
_STEPS = 15
_USUAL, _SPREAD = 2.0, 0.7
"""Prior on the ratio of field to independent errors: median, and standard deviation of its logarithm."""


def has_field(problem: Problem) -> bool:
    """Return whether the truth of any recording has spatially correlated errors."""
    return any(r.truth_field is not None for r in problem.recordings)


def remainder_whitener(intervals: Intervals, q: Array, truth: TruthNoise) -> Whitener:
    """Return the whitener of the residuals with the truth's noise but without its field, which is a random effect.

    Parameters
    ----------
    intervals : K intervals
    q : (K, 3, 3)
        Covariance that the odometry's noise puts on each residual, m and rad.
    truth : noise of the truth in the recordings without a field
    """
    own = intervals.field[:, :2]
    if not own.any():
        return whitener(intervals, q, truth)
    there = own[:, :1] > 0.0
    sigma = np.where(there, own, (truth.xy_m, truth.yaw_rad))[:, [0, 0, 1]]
    outer = sigma[:, :, None] * sigma[:, None, :]
    scaled = replace(
        intervals,
        start_shape=np.where(there[:, :, None], np.eye(3), intervals.start_shape) * outer,
        end_shape=np.where(there[:, :, None], np.eye(3), intervals.end_shape) * outer,
        memory=np.where(there[:, 0], 0.0, intervals.memory),
    )
    return whitener(scaled, q, TruthNoise(1.0, 1.0, truth.random_walk))


def field_roots(problem: Problem) -> Array:
    """Return columns (K, 3, m): times independent standard normal factors, they are the fields of all recordings."""
    parts = []
    for r, recording in enumerate(problem.recordings):
        field = recording.truth_field
        if field is None:
            continue
        own = problem.run == r
        position, heading = _unit_roots(problem.intervals, own, field.length_m)
        parts += [field.xy_m * position, field.yaw_rad * heading]
    return np.concatenate(parts, axis=2) if parts else np.zeros((len(problem.intervals), 3, 0))


def window_roots(recording: Recording, windows: Intervals) -> Array | None:
    """Return a root (n, 3, m) of the covariance that windows of the same places share; None without a field."""
    field = recording.truth_field
    if field is None:
        return None
    position, heading = _unit_roots(windows, np.ones(len(windows), dtype=bool), field.length_m)
    return np.concatenate((field.xy_m * position, field.yaw_rad * heading), axis=2)


def field_of(problem: Problem, q: Array, columns: Array) -> tuple[TruthField, float]:
    """Return the most likely field, with its independent errors, of one recording and its log posterior in nats.

    Parameters
    ----------
    problem : the recording, with no effects removed
    q : (K, 3, 3)
        Covariance of the odometry's noise on each residual.
    columns : (K, 3, m)
        Free linear parameters.
    """
    found = []
    every = np.ones(len(problem.intervals), dtype=bool)
    start = np.log([0.01, 0.005, 0.02, 0.005])
    for length in LENGTHS_M:
        roots = _unit_roots(problem.intervals, every, length)

        def cost(free: Array, roots: tuple[Array, Array] = roots) -> float:
            # a smooth field and a travel scale are aliased: without a prior its size is unbounded
            odd = (free[2:] - free[:2] - np.log(_USUAL)) / _SPREAD
            # the prior of all errors of a localisation, as for errors along the path, to which the field is compared
            prior = prior_of_errors(np.logaddexp(2.0 * free[:2], 2.0 * free[2:]) / 2.0)
            return 0.5 * float(odd @ odd) - prior - _log_likelihood(problem.intervals, q, columns, np.exp(free), roots)

        best = minimize(cost, start, method="L-BFGS-B", bounds=_BOUNDS, options={"eps": 1e-3, "maxiter": _STEPS})
        start = best.x
        own_xy, own_yaw, xy, yaw = map(float, np.exp(best.x))
        found.append((TruthField(own_xy, own_yaw, xy, yaw, length), -float(best.fun)))
    return max(found, key=lambda one: one[1])


def _log_likelihood(intervals: Intervals, q: Array, columns: Array, sizes: Array, roots: tuple[Array, Array]) -> float:
    """Return the log likelihood (nats) with independent errors and a field of sizes (4,): m, rad, m, rad."""
    try:
        white = whitener(replace(intervals, memory=np.zeros(len(intervals))), q, TruthNoise(sizes[0], sizes[1], 0.0))
    except FitError:
        return -1e12
    design = white.whiten(np.concatenate((sizes[2] * roots[0], sizes[3] * roots[1]), axis=2))
    both = white.whiten(np.concatenate((intervals.residual[:, :, None], columns), axis=2))
    inner = np.eye(design.shape[1]) + design.T @ design
    carried = design.T @ both
    normal = both.T @ both - carried.T @ np.linalg.solve(inner, carried)
    theta = np.linalg.lstsq(normal[1:, 1:], normal[1:, 0], rcond=None)[0]
    square = float(normal[0, 0] - normal[1:, 0] @ theta)
    return -white.log_det - 0.5 * float(np.linalg.slogdet(inner)[1]) - 0.5 * square


def _unit_roots(intervals: Intervals, own: Array, length_m: float) -> tuple[Array, Array]:
    """Return the residual columns (K, 3, m) of a unit position field and of a unit heading field."""
    _, end, start = map_axes(replace(intervals, memory=np.zeros(len(intervals))))
    last = intervals.truth_xyt[:, :2] + np.einsum(
        "kji,kj->ki", _turn(intervals.truth_xyt[:, 2]), intervals.truth_step[:, :2]
    )
    at_start, at_end = _basis(intervals.truth_xyt[own, :2], last[own], length_m)
    m = at_start.shape[1]
    roots = np.zeros((2, len(intervals), 3, 2 * m))
    for axis, channel in ((0, 0), (1, 0), (2, 1)):
        shift = m if axis == 1 else 0
        column = start[own][:, :, axis, None] * at_start[:, None] - end[own][:, :, axis, None] * at_end[:, None]
        roots[channel][own, :, shift : shift + m] = column
    return roots[0], roots[1][:, :, :m]


def _turn(angle_rad: Array) -> Array:
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.stack((np.stack((c, s), axis=1), np.stack((-s, c), axis=1)), axis=1)


def _basis(start_xy: Array, end_xy: Array, length_m: float) -> tuple[Array, Array]:
    """Return roots (n, m) of the field's covariance at the starts and at the ends of intervals."""
    both, cell = np.concatenate((start_xy, end_xy)), _CELL * length_m
    while len(centres := np.unique(np.round(both / cell), axis=0)) > _MOST_CELLS:
        cell *= 1.5
    value, vector = eigh(_alike(centres * cell, centres * cell, length_m))
    plain = value > _NOTHING * value[-1]
    project = vector[:, plain] / np.sqrt(value[plain])
    return _alike(start_xy, centres * cell, length_m) @ project, _alike(end_xy, centres * cell, length_m) @ project


def _alike(a: Array, b: Array, length_m: float) -> Array:
    square = np.sum((a[:, None] - b[None]) ** 2, axis=2)
    return np.exp(-0.5 * square / length_m**2)

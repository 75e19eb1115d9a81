"""Robust standard errors: searched shape parameters are free, and variances are those between blocks of the drive.

The fit's own errors hold shapes fixed and assume that the noise model is right. But the edge of a place is known to
some centimetres only, and the slip inside depends on it. And if the noise law is not exact, estimates vary more between
blocks of the drive than predicted (White 1982, Econometrica 50, by blocks).

Sums over blocks are valid even if the noise model is wrong. With few blocks their variance is uncertain, so it is
shrunk towards that of the other columns, as limma does for few arrays (Smyth 2004, section 3).
"""

from __future__ import annotations

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import parameters
from odomcorrupt.study.estimate.noise_likelihood import pseudo_inverse
from odomcorrupt.study.io.clock import clock_leaders, led
from odomcorrupt.study.io.recording import ranks_of

if TYPE_CHECKING:
    from collections.abc import Container

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect, Parameter
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.problem import Problem


PRIOR_DOF = 20.0
"""Weight of the variance ratio shared by all columns, in degrees of freedom."""
BLOCK_S, _FEWEST, _MOST = 15.0, 20, 60
"""Usual length of a block, seconds, over which errors of a robot are correlated, so that blocks are nearly independent;
least and largest number of blocks."""


def block_of(problem: Problem) -> NDArray[np.int64]:
    """Return the block index (K,) of each interval: blocks are about 15 s long and never span two recordings.

    Neither they nor their order depend on the order of the recordings.
    """
    intervals, run = problem.intervals, problem.run
    total = float(np.sum(intervals.end_s - intervals.start_s))
    length = total / int(np.clip(total / BLOCK_S, _FEWEST, _MOST))
    end_s = [intervals.end_s[run == r] for r in np.unique(run)]
    within = np.concatenate([((own_s - own_s[0]) / length).astype(np.int64) for own_s in end_s])
    rank = ranks_of(problem.recordings)[run]
    return np.unique(np.stack((rank, within)), axis=1, return_inverse=True)[1].ravel()


def between_blocks(block: NDArray[np.int64], pull: Array, r: Array) -> tuple[Array, Array]:
    """Return observed over predicted variance of estimates between blocks, and its degrees of freedom, (p,) each.

    block, r : (m,) block index of each innovation, and the innovations
    pull : (m, p) weight of each innovation in each estimate
    """
    first = np.flatnonzero(np.diff(block, prepend=-1))  # of each block
    moved, known = (np.add.reduceat(values, first, axis=0) for values in (pull * r[:, None], pull**2))
    whole = np.maximum(known.sum(axis=0), 1e-300)
    parts = known / whole
    left = moved - parts * moved.sum(axis=0)
    variance: Array = (left**2 / np.maximum(1.0 - parts, 1e-6)).sum(axis=0) / whole
    dof: Array = np.maximum(1.0 / np.maximum(np.sum(parts**2, axis=0), 1e-300) - 1.0, 0.5)
    return variance, dof


def shared_variance(variance: Array, dof: Array) -> float:
    """Return the mean variance ratio of all columns, weighted by degrees of freedom; at least 1 (model correct)."""
    return max(float(np.average(variance, weights=dof)), 1.0) if len(variance) else 1.0


def inflation(variance: Array, dof: Array, shared: float) -> Array:
    """Return the variance ratio of each column, shrunk towards the shared one; at least 1."""
    return np.maximum(1.0, (PRIOR_DOF * shared + dof * variance) / (PRIOR_DOF + dof))


_EDGE = 0.05
"""Step of the finite difference in a shape parameter, as a fraction of its typical size: below an interval's path."""


def with_robust_errors(fitted: Fit, shaped: Container[str] = ()) -> Fit:
    """Return the fit with robust standard errors of its effects' amplitudes and of its clocks.

    shaped : names of effects whose shapes were searched in the same data; other shapes are taken as known
    """
    problem = fitted.problem
    design = fitted.design_matrix
    if not design.shape[2]:
        return fitted
    shapes = [
        (effect, p)
        for effect in fitted.effects
        for p in parameters(effect)
        if effect.name in shaped and not p.amplitude
    ]
    columns = np.concatenate((design, *(_moved_shape(problem, *shape)[:, :, None] for shape in shapes)), axis=2)
    white = fitted.noise.whitener.whiten(columns)
    # prior of a shape: at its value, with its typical size as the standard deviation
    prior = np.diag([0.0] * design.shape[2] + [p.typical**-2.0 for _, p in shapes])
    covariance = pseudo_inverse(white.T @ white + prior)[: design.shape[2]]
    ratio, dof = between_blocks(np.repeat(block_of(problem), 3), white @ covariance.T, fitted.noise.innovations)
    variance = np.diag(covariance) * inflation(ratio, dof, shared_variance(ratio, dof))
    own, errors = len(fitted.standard_errors), np.sqrt(variance)
    free, leaders = np.array(fitted.free_clocks), clock_leaders(problem.recordings)
    clock_errors = np.zeros(free.shape)
    clock_errors[led(free, leaders)] = errors[own:]
    plain = dataclasses.replace(problem, effects=tuple(effect.plain() for effect in problem.effects))
    return dataclasses.replace(fitted, problem=plain, standard_errors=errors[:own], clock_errors=clock_errors[leaders])


def _moved_shape(problem: Problem, effect: Effect, p: Parameter) -> Array:
    """Return the derivative (K, 3) of the residuals by a shape parameter, as a finite difference across edges."""
    sides = []
    for sign in (1.0, -1.0):
        value = float(np.clip(getattr(effect, p.name) + sign * _EDGE * p.typical, p.low, p.high))
        moved = dataclasses.replace(effect, **{p.name: value})  # type: ignore[type-var]  # effects are dataclasses
        sides.append((value, problem.explained(moved)))
    (high, more), (low, less) = sides
    return (more - less) / max(high - low, 1e-12)

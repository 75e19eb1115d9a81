"""Rates of error: by how much odometry errs per metre in some part of a drive, and what chance would make.

Everything here is odometry minus truth: a positive rate along means that the odometry ends too far ahead, across too
far left, yaw that it turns too far left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.estimate.whitener import Whitener

__all__ = ["CHANNELS", "NodeMotion", "Rates", "joint_rates", "node_motion", "unit_columns"]

CHANNELS = ("along", "across", "yaw")
MOVING = 0.02
"""Slower than this, m/s, is at rest."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeMotion:
    """Motion over each of K intervals, (K,) each.

    t_s : its end, since the recording's origin, seconds
    metres, seconds : how far and how long it went
    v, omega, a : mean forward speed m/s, yaw rate rad/s, forward acceleration m/s^2
    x, y, heading : the truth where it begins, m and rad
    distance : travelled until its end since the run began, m
    """

    t_s: Array
    metres: Array
    seconds: Array
    v: Array
    omega: Array
    a: Array
    x: Array
    y: Array
    heading: Array
    distance: Array


def node_motion(problem: Problem) -> NodeMotion:
    """Return the motion of every interval, from the smooth motion that drives the regressors."""
    nodes, motions = problem.nodes, problem.motions
    dt = np.concatenate([m.dt_s for m in motions])
    columns = [dt] + [
        np.concatenate(part) * dt
        for part in (
            [np.hypot(m.v, m.vy) for m in motions],
            [m.v for m in motions],
            [m.omega for m in motions],
            [m.a for m in motions],
        )
    ]
    weighted = np.stack(columns, axis=1)[nodes.source] * nodes.share[:, None]
    seconds, metres, v, omega, a = np.add.reduceat(weighted, nodes.first, axis=0).T
    per = 1.0 / np.maximum(seconds, 1e-9)
    distance = np.concatenate([np.cumsum(metres[problem.run == r]) for r in np.unique(problem.run)])
    x, y, heading = nodes.truth_xyt.T
    return NodeMotion(
        t_s=nodes.end_s,
        metres=metres,
        seconds=seconds,
        v=v * per,
        omega=omega * per,
        a=a * per,
        x=x,
        y=y,
        heading=heading,
        distance=distance,
    )


def unit_columns(problem: Problem, *, per_second: bool = False) -> Array:
    """Return (K, 3, 3): what a rate of one per metre (or second) in each channel does to the residuals.

    Multiplied by a mask over the intervals, a column is that rate in a part of the drive.
    """
    parts = [m.dt_s if per_second else np.hypot(m.v, m.vy) * m.dt_s for m in problem.motions]
    weight = np.concatenate(parts)
    columns = []
    for c in range(3):
        error = np.zeros((len(weight), 3))
        error[:, c] = weight
        columns.append(problem.nodes.column(error))
    return np.stack(columns, axis=2)


@dataclass(frozen=True, slots=True)
class Rates:
    """Rates of one channel in B parts of a drive, estimated together.

    estimate : (B,) m/m or rad/m, odometry minus truth; NaN where a part is too small
    allowed : (B,) standard deviation that the model's noise alone gives the estimate
    """

    estimate: Array
    allowed: Array


def joint_rates(whitener: Whitener, innovations: Array, unit: Array, part: NDArray[np.int64], count: int) -> Rates:
    """Return rates of one channel for parts of a drive that do not overlap.

    Parameters
    ----------
    whitener, innovations : of the residuals; innovations (3 K,)
    unit : (K, 3) column of the channel, from `unit_columns`
    part : (K,) index of the part each interval belongs to, -1 for none
    count : how many parts there are

    """
    masks = part[:, None] == np.arange(count)
    held = np.sum(masks, axis=0) > 0
    estimate, allowed = np.full(count, np.nan), np.full(count, np.nan)
    white = whitener.whiten(unit[:, :, None] * masks[:, None, held])
    covariance = np.linalg.pinv(white.T @ white, hermitian=True)
    estimate[held] = covariance @ (white.T @ innovations)
    allowed[held] = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return Rates(estimate, allowed)

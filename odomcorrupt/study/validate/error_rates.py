"""Error rates: odometry error per metre in parts of a drive, with the standard deviation that the model predicts.

All errors are odometry minus truth: a positive rate along means that the odometry ends too far ahead, across too far to
the left, and yaw that it turns too far to the left.
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

CHANNELS = ("along", "across", "yaw")
MOVING = 0.02
"""Speed below which the robot counts as at rest, m/s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IntervalMotion:
    """Motion over each of K intervals, (K,) each.

    t_s : time of its end since the recording's origin, seconds
    metres, seconds : distance travelled and duration
    v, omega, a : mean forward speed m/s, yaw rate rad/s, forward acceleration m/s^2
    x, y, heading : truth at its start, m and rad
    distance : travelled from the start of the run to its end, m
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


def interval_motion(problem: Problem) -> IntervalMotion:
    """Return the motion over every interval, from the smoothed motion of the regressors."""
    intervals, motions = problem.intervals, problem.motions
    dt = np.concatenate([m.dt_s for m in motions])
    columns = [dt] + [
        np.concatenate(part) * dt
        for part in (
            [m.speed for m in motions],
            [m.v for m in motions],
            [m.omega for m in motions],
            [m.a for m in motions],
        )
    ]
    weighted = np.stack(columns, axis=1)[intervals.source] * intervals.share[:, None]
    seconds, metres, v, omega, a = np.add.reduceat(weighted, intervals.first, axis=0).T
    per = 1.0 / np.maximum(seconds, 1e-9)
    distance = np.concatenate([np.cumsum(metres[problem.run == r]) for r in np.unique(problem.run)])
    x, y, heading = intervals.truth_xyt.T
    return IntervalMotion(
        t_s=intervals.end_s,
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
    """Return the residuals (K, 3, 3) caused by an error rate of one per metre (or second) in each channel.

    Multiplied by a mask over the intervals, a column is that rate in a part of the drive.
    """
    parts = [m.dt_s if per_second else m.travel for m in problem.motions]
    weight = np.concatenate(parts)
    columns = []
    for c in range(3):
        error = np.zeros((len(weight), 3))
        error[:, c] = weight
        columns.append(problem.intervals.column(error))
    return np.stack(columns, axis=2)


@dataclass(frozen=True, slots=True)
class Rates:
    """Jointly estimated rates of one channel in B parts of a drive.

    estimate : (B,) m/m or rad/m, odometry minus truth; NaN if a part has no intervals
    allowed : (B,) standard deviation of the estimate from the model's noise alone
    """

    estimate: Array
    allowed: Array


def joint_rates(whitener: Whitener, innovations: Array, unit: Array, part: NDArray[np.int64], count: int) -> Rates:
    """Return error rates of one channel in disjoint parts of a drive.

    Parameters
    ----------
    whitener, innovations : of the residuals; innovations (3 K,)
    unit : (K, 3) column of the channel, from `unit_columns`
    part : (K,) index of each interval's part, -1 for none
    count : number of parts
    """
    masks = part[:, None] == np.arange(count)
    held = np.sum(masks, axis=0) > 0
    estimate, allowed = np.full(count, np.nan), np.full(count, np.nan)
    white = whitener.whiten(unit[:, :, None] * masks[:, None, held])
    covariance = np.linalg.pinv(white.T @ white, hermitian=True)
    estimate[held] = covariance @ (white.T @ innovations)
    allowed[held] = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    return Rates(estimate, allowed)

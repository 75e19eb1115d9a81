"""Jumps in a path: outliers (spikes, or there and back) are left out, lasting ones cut it into independent stretches.

A reset of the odometry, a tracker that swaps its markers or a map that is shifted say nothing about how odometry errs:
nothing may be computed across them. What lies before and after is a run of its own, with a clock of its own.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import wrap
from odomcorrupt.study.io.spikes import without_spikes

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["Reach", "Stretches", "reach_of", "stretches", "without_outliers"]

OUTLIER_S = 3.0
"""What lasts shorter than this between two jumps is an outlier, what lasts longer a stretch of its own."""
_SPEED_S = 0.1
_MARGIN = 4.0
_SLACK = (np.array([0.1, 0.3]), np.array([3.0, 1.5]))
"""Least and largest slack, m and rad: what looks like more noise than the largest is two paths in one."""
_SPIKE = np.array([0.03, 0.03])
"""Least that a single pose must be off to be left out, m and rad: ticks and jitter are less."""
_SIGMAS = 20.0
_LEVER_M = 1.0
_MOST_JUMPS = 0.2


@dataclass(frozen=True, slots=True)
class Reach:
    """How far a path can go in a time: rate (2,) m/s and rad/s, plus slack (2,) m and rad.

    top, noise : (2,) rate that is usual, and what noise does at most
    """

    rate: Array
    slack: Array
    top: Array
    noise: Array


@dataclass(frozen=True, slots=True)
class Stretches:
    """Indices of the samples of each stretch, and how many samples are outliers."""

    rows: tuple[NDArray[np.int64], ...]
    outliers: int


def reach_of(odometry: Samples, path: Samples) -> Reach:
    """Return how far a path of a robot with this odometry can go: a few times its usual top speed, and its noise.

    Top speed is taken over a tenth of a second, because stamps bunch.
    """
    t_s = odometry.seconds_since(int(odometry.stamps_ns[0]))
    k = int(np.clip(np.ceil(_SPEED_S / np.median(np.diff(t_s))), 1, max(len(t_s) // 4, 1)))
    dt = t_s[k:] - t_s[:-k]
    gone = np.linalg.norm(odometry.xyz[k:, :2] - odometry.xyz[:-k, :2], axis=1) / dt
    turned = np.abs(wrap(odometry.yaw_rad[k:] - odometry.yaw_rad[:-k])) / dt if odometry.headed else np.zeros(1)
    top = np.array([_top(gone), _top(turned)])
    lever = np.array([0.0 if path is odometry else _LEVER_M * top[1], 0.0])
    return Reach(
        rate=_MARGIN * top + lever,
        slack=np.clip(_SIGMAS * _noise(path, 0.5), *_SLACK),
        top=top + lever,
        # trackers have their bad moments
        noise=np.clip(_SIGMAS * _noise(path, 0.9), _SPIKE, _SLACK[1]),
    )


def without_outliers(path: Samples) -> Samples:
    """Return the samples that its own speeds explain: enough for checks that one gross outlier would mislead."""
    cut = stretches(path, reach_of(path, path))
    return path.only(np.concatenate(cut.rows)) if cut.outliers else path


def stretches(path: Samples, reach: Reach) -> Stretches:
    """Return the stretches that a robot can have driven.

    Raises
    ------
    RecordingError
        Where there are more jumps than path.

    """
    t_s = path.seconds_since(int(path.stamps_ns[0]))
    xy, yaw = path.xyz[:, :2], np.where(np.isnan(path.yaw_rad), 0.0, path.yaw_rad)

    def far(a: NDArray[np.int64] | int, b: NDArray[np.int64] | int) -> NDArray[np.bool_]:
        dt = np.abs(t_s[b] - t_s[a])
        gone = np.linalg.norm(xy[b] - xy[a], axis=-1)
        turned = np.abs(wrap(np.asarray(yaw[b] - yaw[a])))
        over: NDArray[np.bool_] = (gone > reach.rate[0] * dt + reach.slack[0]) | (
            turned > reach.rate[1] * dt + reach.slack[1]
        )
        return over

    every = np.arange(len(path))
    jump = far(every[:-1], every[1:])
    if np.mean(jump) > _MOST_JUMPS:
        raise RecordingError(
            f"{path.place}: {np.sum(jump)} of its {len(path)} poses lie farther from the one before than the robot can "
            "go: several robots or publishers on one topic, or no path at all; name another one"
        )
    rows = without_spikes(t_s, np.column_stack((xy, yaw)), reach.top, reach.noise)
    pieces = np.split(rows, np.flatnonzero(far(rows[:-1], rows[1:])) + 1)
    main = int(np.argmax([len(p) for p in pieces]))
    groups, outliers = [[pieces[main]]], len(path) - len(rows)
    for ordered, end, begin, at in ((pieces[main + 1 :], -1, 0, -1), (pieces[:main][::-1], 0, -1, 0)):
        for piece in ordered:
            last = groups[at][at]
            if not far(int(last[end]), int(piece[begin])):
                groups[at].insert(len(groups[at]) if at else 0, piece)
            elif t_s[piece[-1]] - t_s[piece[0]] >= OUTLIER_S:
                groups.insert(len(groups) if at else 0, [piece])
            else:
                outliers += len(piece)
    return Stretches(tuple(np.concatenate(group) for group in groups), outliers)


def _top(speeds: Array) -> float:
    """Return the speed that is hardly ever passed while moving."""
    moving = speeds[speeds > 1e-3]
    return float(np.percentile(moving, 95.0)) if len(moving) else 0.0


def _noise(path: Samples, part: float) -> Array:
    """Return the white noise (2,) of position and heading, by the second differences that a part of them are below."""
    xy = np.abs(np.diff(path.xyz[:, :2], n=2, axis=0))
    yaw = np.abs(np.diff(wrap(np.diff(path.yaw_rad)))) if path.headed else np.zeros(1)
    below = np.array([np.quantile(xy, part) if len(xy) else 0.0, np.quantile(yaw, part) if len(yaw) else 0.0])
    noise: Array = below / NormalDist().inv_cdf((1.0 + part) / 2.0) / np.sqrt(6.0)
    return noise

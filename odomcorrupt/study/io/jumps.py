"""Jumps in a path: short ones (spikes, or there and back) are removed, lasting ones split it into stretches.

A reset of the odometry, a tracker that swaps its markers or a shifted map is no odometry error, so no increment may
span it. The parts before and after are separate runs with separate clocks.

Swapped markers turn a pose by any angle, often by less than the threshold of a jump. One side of it may then look like
motion and the other like a jump of everything that follows, so spikes are removed before jumps are detected. Only poses
are tested, not stamps: stamps may be bunched, and a late pose still belongs to the path.
"""

from __future__ import annotations

from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

OUTLIER_S = 3.0
"""Longest outlier: a longer piece between two jumps is a stretch."""
_SPEED_S = 0.1  # time over which top speeds are measured
_MARGIN = 4.0  # factor from usual top speed to possible speed
_SLACK = (np.array([0.1, 0.3]), np.array([3.0, 1.5]))
"""Smallest and largest slack, m and rad; noise above the largest suggests two paths in one."""
_SPIKE = np.array([0.03, 0.03])
"""Least deviation of a single pose that is removed, m and rad; ticks and jitter are smaller."""
_SIGMAS = 20.0
_LEVER_M = 1.0  # assumed distance of the truth's tracked point from the odometry's
_MAX_JUMPS = 0.2  # fraction of steps that may be jumps


@dataclass(frozen=True, slots=True)
class Reach:
    """Largest possible motion in a time t: rate * t + slack, with rate (2,) m/s and rad/s, slack (2,) m and rad.

    top, noise : (2,) usual top speed and turn rate; upper bound of the noise, m and rad
    """

    rate: Array
    slack: Array
    top: Array
    noise: Array


@dataclass(frozen=True, slots=True)
class Stretches:
    """Indices of the samples of each stretch, and the number of outliers."""

    rows: tuple[NDArray[np.int64], ...]
    outliers: int


def reach_of(odometry: Samples, path: Samples) -> Reach:
    """Return the largest possible motion of a path, from the usual top speed of the odometry and the path's noise.

    Speeds are taken over 0.1 s, because stamps may be bunched.
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
        # higher quantile: trackers have occasional bursts of noise
        noise=np.clip(_SIGMAS * _noise(path, 0.9), _SPIKE, _SLACK[1]),
    )


def without_outliers(path: Samples) -> Samples:
    """Return the samples consistent with the path's own top speed, for checks that gross outliers would mislead."""
    cut = stretches(path, reach_of(path, path))
    return path.only(np.concatenate(cut.rows)) if cut.outliers else path


def stretches(path: Samples, reach: Reach) -> Stretches:
    """Return the stretches of a path between lasting jumps.

    Raises
    ------
    RecordingError
        If more than 20 % of the steps are jumps.
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
    if np.mean(jump) > _MAX_JUMPS:
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
    """Return the 95th percentile of the speeds while moving."""
    moving = speeds[speeds > 1e-3]
    return float(np.percentile(moving, 95.0)) if len(moving) else 0.0


def _noise(path: Samples, part: float) -> Array:
    """Return the white noise (2,) of position and heading, m and rad, from a quantile of their second differences."""
    xy = np.abs(np.diff(path.xyz[:, :2], n=2, axis=0))
    yaw = np.abs(np.diff(wrap(np.diff(path.yaw_rad)))) if path.headed else np.zeros(1)
    below = np.array([np.quantile(xy, part) if len(xy) else 0.0, np.quantile(yaw, part) if len(yaw) else 0.0])
    noise: Array = below / NormalDist().inv_cdf((1.0 + part) / 2.0) / np.sqrt(6.0)
    return noise


LONGEST = 5
"""Longest spike in poses; longer ones are left to the detection of jumps."""
_ROUNDS = 20


def without_spikes(t_s: Array, xyt: Array, top: Array, limit: Array) -> NDArray[np.int64]:
    """Return the indices of the poses that are not spikes.

    Parameters
    ----------
    t_s, xyt : (n,), (n, 3)
        Times and poses, seconds, metres and radians.
    top : (2,)
        Usual top speed and turn rate of the robot, m/s and rad/s.
    limit : (2,)
        Upper bound of the noise, m and rad.
    """
    kept = np.arange(len(t_s))
    for _ in range(_ROUNDS):
        own_s, own_xyt = t_s[kept], xyt[kept]
        over = _apart(own_xyt[:-1], own_xyt[1:]) > limit + top * np.diff(own_s)[:, None]
        steps = over[:, 0] | over[:, 1]
        found = (_spikes(own_s, own_xyt, top, limit, steps, count) for count in range(1, LONGEST + 1) if steps.any())
        # The shortest spikes first; the remaining poses are tested again without them.
        bad = next((rows for rows in found if len(rows)), None)
        if bad is None:
            break
        kept = np.delete(kept, bad)
    return kept


def _spikes(
    t_s: Array, xyt: Array, top: Array, limit: Array, stands_out: NDArray[np.bool_], count: int
) -> NDArray[np.int64]:
    """Return the indices of all spikes of `count` consecutive poses, given the steps (n - 1,) above the limit."""
    # A spike begins and ends with a large step; on at least one side, the adjacent step is small.
    before = np.flatnonzero(stands_out)
    after = before + count + 1
    inside = (before >= 1) & (after < len(t_s) - 1)
    before, after = before[inside], after[inside]
    trusted = stands_out[after - 1] & ~(stands_out[before - 1] & stands_out[after])
    before, after = before[trusted], after[trusted]
    moved = _apart(xyt[before], xyt[after])
    slack = limit + top * (t_s[after] - t_s[before])[:, None]
    # The smallest deviation of the poses in between, because each of them must be wrong.
    least = np.full(moved.shape, np.inf)
    for i in range(1, count + 1):
        least = np.minimum(least, _off(xyt[before], xyt[before + i], xyt[after]))
    # The neighbours agree if their distance is within the limit, or below the deviation of the spike.
    spike = (moved < np.maximum(slack, least)).all(axis=1) & (least > slack).any(axis=1)
    rows: NDArray[np.int64] = (before[spike][:, None] + np.arange(1, count + 1)).ravel()
    return rows


def _apart(a_xyt: Array, b_xyt: Array) -> Array:
    """Return the distances (n, 2) between poses (n, 3), m and rad."""
    gone = np.linalg.norm(b_xyt[:, :2] - a_xyt[:, :2], axis=1)
    return np.stack((gone, np.abs(wrap(b_xyt[:, 2] - a_xyt[:, 2]))), axis=1)


def _off(a_xyt: Array, xyt: Array, b_xyt: Array) -> Array:
    """Return the deviations (n, 2) of poses (n, 3) from the straight line between a and b, m and rad."""
    way, gone = b_xyt[:, :2] - a_xyt[:, :2], xyt[:, :2] - a_xyt[:, :2]
    part = np.clip(np.sum(way * gone, axis=1) / np.maximum(np.sum(way**2, axis=1), 1e-12), 0.0, 1.0)
    off_m = np.linalg.norm(gone - part[:, None] * way, axis=1)
    turn, turned = wrap(b_xyt[:, 2] - a_xyt[:, 2]), wrap(xyt[:, 2] - a_xyt[:, 2])
    nearest = np.clip(turned, np.minimum(turn, 0.0), np.maximum(turn, 0.0))
    return np.stack((off_m, np.abs(wrap(turned - nearest))), axis=1)

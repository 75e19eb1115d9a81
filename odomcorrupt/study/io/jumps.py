"""Jumps in a path: short ones (spikes, excursions of the truth) are removed, lasting ones split it into stretches.

A reset of the odometry, a tracker that swaps its markers or a shifted map is no odometry error, so no increment may
span it. Swapped markers turn a pose by any angle: one side of it may look like motion and the other like a jump of all
that follows, so spikes are removed before jumps are detected.

Excursions of the truth depart from the odometry and return, as of a localisation that is lost for some seconds; a robot
that was pushed or lifted stays at its new place. Running medians of truth minus odometry separate the two: a median
follows a lasting step and ignores a short one.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from dataclasses import dataclass
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import rotate, wrap
from odomcorrupt.geometry.trajectory import distance_along
from odomcorrupt.study.io.raw_trajectory import runs_of

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
_SIGMAS, _FIX_SIGMAS = 20.0, 8.0
"""Standard deviations of the noise below which a step is no jump, and a fix of radio or satellites (positions without
headings) beside two that agree no spike: one in a hundred is off by metres."""
_LEVER_M = 1.0  # assumed distance of the truth's tracked point from the odometry's


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
    t_s = odometry.t_s
    k = int(np.clip(np.ceil(_SPEED_S / np.median(np.diff(t_s))), 1, max(len(t_s) // 4, 1)))
    dt = t_s[k:] - t_s[:-k]
    gone = np.linalg.norm(odometry.xyz[k:, :2] - odometry.xyz[:-k, :2], axis=1) / dt
    turned = np.abs(wrap(odometry.yaw_rad[k:] - odometry.yaw_rad[:-k])) / dt if odometry.headed else np.zeros(1)
    # 95th percentiles of the speeds while moving
    top = np.array([np.percentile(s[s > 1e-3], 95.0) if (s > 1e-3).any() else 0.0 for s in (gone, turned)])
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
    """Return the stretches of a path between lasting jumps."""
    t_s = path.t_s
    xyt = np.column_stack((path.xyz[:, :2], np.nan_to_num(path.yaw_rad)))

    def far(a: NDArray[np.int64], b: NDArray[np.int64]) -> NDArray[np.bool_]:
        dt = np.abs(t_s[b] - t_s[a])[..., None]
        return np.asarray((_apart(xyt[a], xyt[b]) > reach.rate * dt + reach.slack).any(axis=-1))

    least = reach.noise if path.headed else np.maximum(_FIX_SIGMAS / _SIGMAS * reach.noise, _SPIKE)
    rows = without_spikes(t_s, xyt, reach.top, least)
    pieces = np.split(rows, np.flatnonzero(far(rows[:-1], rows[1:])) + 1)
    main = int(np.argmax([len(p) for p in pieces]))
    groups, outliers = [[pieces[main]]], len(path) - len(rows)
    for ordered, end, begin, at in ((pieces[main + 1 :], -1, 0, -1), (pieces[:main][::-1], 0, -1, 0)):
        for piece in ordered:
            if not far(groups[at][at][end], piece[begin]):
                groups[at].insert(len(groups[at]) if at else 0, piece)
            elif t_s[piece[-1]] - t_s[piece[0]] >= OUTLIER_S:
                groups.insert(len(groups) if at else 0, [piece])
            else:
                outliers += len(piece)
    return Stretches(tuple(np.concatenate(group) for group in groups), outliers)


def _noise(path: Samples, part: float) -> Array:
    """Return the white noise (2,) of position and heading, m and rad, from a quantile of their second differences."""
    xy = np.abs(np.diff(path.xyz[:, :2], n=2, axis=0))
    yaw = np.abs(np.diff(wrap(np.diff(path.yaw_rad)))) if path.headed else np.zeros(1)
    below = np.array([np.quantile(xy, part) if len(xy) else 0.0, np.quantile(yaw, part) if len(yaw) else 0.0])
    return below / NormalDist().inv_cdf((1.0 + part) / 2.0) / np.sqrt(6.0)


LONGEST = 5
"""Longest spike in poses; longer ones are left to the detection of jumps."""
_ROUNDS = 20


def without_spikes(t_s: Array, xyt: Array, top: Array, limit: Array) -> NDArray[np.int64]:
    """Return the indices of the poses that are not spikes.

    t_s, xyt : (n,) times and (n, 3) poses, seconds, metres and radians
    top : (2,) usual top speed and turn rate of the robot, m/s and rad/s
    limit : (2,) upper bound of the noise, m and rad
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
    return (before[spike][:, None] + np.arange(1, count + 1)).ravel()


def _apart(a_xyt: Array, b_xyt: Array) -> Array:
    """Return the distances (..., 2) between poses (..., 3), m and rad."""
    moved = b_xyt - a_xyt
    return np.stack((np.linalg.norm(moved[..., :2], axis=-1), np.abs(wrap(moved[..., 2]))), axis=-1)


def _off(a_xyt: Array, xyt: Array, b_xyt: Array) -> Array:
    """Return the deviations (n, 2) of poses (n, 3) from the straight line between a and b, m and rad."""
    way, gone = b_xyt[:, :2] - a_xyt[:, :2], xyt[:, :2] - a_xyt[:, :2]
    part = np.clip(np.sum(way * gone, axis=1) / np.maximum(np.sum(way**2, axis=1), 1e-12), 0.0, 1.0)
    off_m = np.linalg.norm(gone - part[:, None] * way, axis=1)
    turn, turned = wrap(b_xyt[:, 2] - a_xyt[:, 2]), wrap(xyt[:, 2] - a_xyt[:, 2])
    nearest = np.clip(turned, np.minimum(turn, 0.0), np.maximum(turn, 0.0))
    return np.stack((off_m, np.abs(wrap(turned - nearest))), axis=1)


_REACH_S = 20.0
"""Half the window of the running medians, seconds; departures that last longer are no excursions."""
_MIN_POSES = 7
"""Fewest poses in a window for a running median."""
_PEAK_SIGMAS, _STILL_SIGMAS = 5.0, 3.0
"""Thresholds of a departure, in standard deviations of usual poses: at its peak, and at its beginning and end."""
_MIN_APART = np.array([0.05, 0.03])
"""Smallest departure of an excursion, metres and radians."""
_MAX_FRACTION = 0.2
"""Fraction of departing poses above which nothing is removed: departures are then usual for this truth."""
_MAX_LEFT, _FEW_BESIDE = 0.5, 4
"""Largest departure left after an excursion, as a fraction of its size; least number of poses on each side."""
_FLIP_RAD = 1.3
"""Step of the heading difference, radians, that counts as a flip; its direction then cannot be inferred."""


def without_excursions(odometry: Samples, truth: Samples) -> Samples:
    """Return a truth without its excursions; a truth without headings is returned unchanged.

    A tracker's excursion must begin or end with a step beyond the robot's reach, because trackers fail suddenly and
    localisations gradually. Single outliers of a tracker are kept, and ignored in this test.

    odometry, truth : sorted by stamp, with clocks that nearly agree
    """
    if not (truth.headed and odometry.headed):
        return truth
    whole, truth = truth, truth if truth.localised else without_outliers(truth)
    t_s = truth.seconds_since(int(odometry.stamps_ns[0]))
    own_s = odometry.t_s
    inside = np.flatnonzero(truth.within(odometry))
    if len(inside) < _MIN_POSES:
        return whole
    apart = np.zeros((len(truth), 2))
    apart[inside], difference = _departures(odometry, own_s, truth, t_s, inside)
    usual = 1.4826 * np.median(np.abs(apart[inside]), axis=0) / (1.18, 1.0)
    far = apart > np.maximum(_PEAK_SIGMAS * usual, _MIN_APART)
    out, near = far.any(axis=1), (apart > np.maximum(_STILL_SIGMAS * usual, _MIN_APART)).any(axis=1)
    reach = reach_of(odometry, truth)
    # An excursion includes its way out and back, and interruptions by noise.
    for first, end in runs_of(near):
        begin, after = first - inside[0], end - inside[0]
        if truth.localised:
            back = bool((_returns(t_s[inside], difference, begin, after) | ~far[first:end].any(axis=0)).all())
        else:
            back = _is_sudden(reach, t_s[inside], difference, begin, after)
        out[first:end] = out[first:end].any() and back
    if not out.any() or out.mean() > _MAX_FRACTION:
        return whole
    rows = np.flatnonzero(out)
    groups = np.split(rows, np.flatnonzero(np.diff(t_s[rows]) > OUTLIER_S) + 1)
    where = ", ".join(
        f"{np.max(apart[g, 0]):.2f} m and {np.degrees(np.max(apart[g, 1])):.0f} deg at {t_s[g[0]]:.0f} s"
        for g in groups[:6]
    )
    what = "an excursion that comes back" if len(groups) == 1 else f"{len(groups)} excursions that come back"
    whose = "localisation, or slip that took itself back" if truth.localised else "truth"
    kept = ~np.isin(whole.stamps_ns, truth.stamps_ns[out])
    return whole.only(kept, f"{what}, {len(rows)} poses, left out ({where}): errors of the {whose}")


def _is_sudden(reach: Reach, t_s: Array, difference: Array, first: int, end: int) -> bool:
    """Return whether the poses `first` to `end` begin or end with an impossible step while their neighbours agree.

    difference : (m, 3) truth minus odometry at times (m,), in m, m, rad
    """
    if first < 1 or end >= len(t_s):
        return False

    slack = reach.noise + reach.top * (t_s[[first, end]] - t_s[[first - 1, end - 1]])[:, None]
    largest = _apart(difference[first - 1], difference[first:end]).max(axis=0)
    steps = _apart(difference[[first - 1, end - 1]], difference[[first, end]])
    stays = _apart(difference[first - 1], difference[end])
    return bool((steps > slack).any() and (stays < np.maximum(_MAX_LEFT * largest, _MIN_APART)).all())


def _departures(
    odometry: Samples, own_s: Array, truth: Samples, t_s: Array, inside: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Return departures from the running medians of truth minus odometry (m, 2), and the difference (m, 3); m, rad."""
    at = t_s[inside]
    heading = np.interp(at, own_s, np.unwrap(odometry.yaw_rad))
    apart = truth.yaw_rad[inside] - heading
    turns = wrap(np.diff(apart))
    turns[np.abs(turns) > _FLIP_RAD] = 0.0
    calm = apart[0] + np.concatenate(([0.0], np.cumsum(turns)))  # unwrapped without flips by half a turn
    turned = calm + wrap(apart - calm)
    way = distance_along(odometry.xyz)
    design = np.stack((np.ones(len(at)), at, heading, np.interp(at, own_s, way)), axis=1)
    # Gyro bias, heading gain and unequal wheels act all the time: remove their contribution by regression.
    steady = design @ np.linalg.lstsq(design, calm, rcond=None)[0]
    usual = steady + _medians(at, (turned - steady)[:, None])[:, 0]
    # Integrate the odometry's path with the truth's usual headings.
    path = np.stack([np.interp(at, own_s, odometry.xyz[:, axis]) for axis in (0, 1)], axis=1)
    steps = rotate(np.diff(path, axis=0), (usual[1:] + usual[:-1]) / 2.0)
    laid = np.concatenate((np.zeros((1, 2)), np.cumsum(steps, axis=0)))
    # Remove the error of the travelled length, too: it grows with the path.
    away = truth.xyz[inside, :2] - laid
    similar = np.stack((laid.ravel(), (laid[:, ::-1] * (-1.0, 1.0)).ravel(), *np.tile(np.eye(2), len(laid))), axis=1)
    away = away - (similar[:, :2] @ np.linalg.lstsq(similar, away.ravel(), rcond=None)[0][:2]).reshape(-1, 2)
    departures = np.stack((np.linalg.norm(away - _medians(at, away), axis=1), np.abs(turned - usual)), axis=1)
    return departures, np.column_stack((away, turned - steady))


def _returns(t_s: Array, difference: Array, first: int, end: int) -> NDArray[np.bool_]:
    """Return whether position and heading (2,) of truth minus odometry (m, 3) return after the poses `first` to `end`.

    Needed because a running median follows a lasting step at once only if poses are as frequent after it as before.
    """
    begin, last = np.searchsorted(t_s, (t_s[first] - _REACH_S, t_s[end - 1] + _REACH_S)).tolist()
    if first - begin < _FEW_BESIDE or last - end < _FEW_BESIDE:
        return np.ones(2, dtype=bool)
    parts = np.split(difference[begin:last], (first - begin, end - begin))
    before, within, after = (np.median(part, axis=0) for part in parts)
    stays, away = (np.array((np.linalg.norm(d[:2]), abs(d[2]))) for d in (after - before, within - before))
    return stays < np.maximum(_MAX_LEFT * away, _MIN_APART)


def _medians(t_s: Array, values: Array) -> Array:
    """Return running medians (n, c) of values (n, c); values with too few neighbours are returned unchanged."""
    first, last = np.searchsorted(t_s, t_s - _REACH_S), np.searchsorted(t_s, t_s + _REACH_S, side="right")
    bounds = list(zip(first.tolist(), last.tolist(), strict=True))
    medians = values.copy()
    for c, column in enumerate(values.T.tolist()):
        ordered: list[float] = []
        begin = end = 0
        for i, (a, b) in enumerate(bounds):
            for one in column[end:b]:
                insort(ordered, one)
            for one in column[begin:a]:
                del ordered[bisect_left(ordered, one)]
            begin, end = a, b
            if b - a >= _MIN_POSES:
                half = (b - a) // 2
                medians[i, c] = (ordered[half] + ordered[~half]) / 2.0
    return medians

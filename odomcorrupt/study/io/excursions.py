"""Removal of excursions of the truth: poses that depart from the odometry for some seconds and then return.

Examples are a localisation that is lost for some seconds, and a tracker that swaps two markers: both are off by
decimetres and return. A robot that was pushed or lifted stays at its new place. Running medians of the difference
between truth and odometry separate the two: a median follows a lasting step and ignores a short one.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.geometry.se2 import rotate, wrap
from odomcorrupt.study.io.jumps import reach_of, without_outliers

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.jumps import Reach
    from odomcorrupt.study.io.raw_trajectory import Samples

_REACH_S = 20.0
"""Half the window of the running medians, seconds; departures that last longer are no excursions."""
_MIN_POSES = 7
"""Fewest poses in a window for a running median."""
_SIGMAS, _STILL_SIGMAS = 5.0, 3.0
"""Thresholds of a departure, in standard deviations of usual poses: at its peak, and at its beginning and end."""
_MIN_APART = np.array([0.05, 0.03])
"""Smallest departure of an excursion, metres and radians."""
_MAX_FRACTION = 0.2
"""Fraction of departing poses above which nothing is removed: departures are then usual for this truth."""
_APART_S = 3.0
_MAX_LEFT, _FEW_BESIDE = 0.5, 4
"""Largest departure left after an excursion, as a fraction of its size; least number of poses on each side."""
_FLIP_RAD = 1.3
"""Step of the heading difference, radians, that counts as a flip; its direction then cannot be inferred."""


def without_excursions(odometry: Samples, truth: Samples) -> Samples:
    """Return a truth without its excursions; a truth without headings is returned unchanged.

    A tracker's excursion must begin or end with a step beyond the robot's reach, because trackers fail suddenly and
    localisations gradually. Single outliers of a tracker are kept, and ignored in this test.

    Parameters
    ----------
    odometry, truth : sorted by stamp, with clocks that nearly agree
    """
    if not (truth.headed and odometry.headed):
        return truth
    whole, truth = truth, truth if truth.localised else without_outliers(truth)
    t_s = truth.seconds_since(int(odometry.stamps_ns[0]))
    own_s = odometry.seconds_since(int(odometry.stamps_ns[0]))
    inside = np.flatnonzero((t_s >= own_s[0]) & (t_s <= own_s[-1]))
    if len(inside) < _MIN_POSES:
        return whole
    apart = np.zeros((len(truth), 2))
    apart[inside], difference = _departures(odometry, own_s, truth, t_s, inside)
    usual = 1.4826 * np.median(np.abs(apart[inside]), axis=0) / (1.18, 1.0)
    far = apart > np.maximum(_SIGMAS * usual, _MIN_APART)
    out, near = far.any(axis=1), (apart > np.maximum(_STILL_SIGMAS * usual, _MIN_APART)).any(axis=1)
    sudden = None if truth.localised else _Sudden(reach_of(odometry, truth), t_s[inside], difference)
    # An excursion includes its way out and back, and interruptions by noise.
    edges = np.flatnonzero(np.diff(np.concatenate(([0], near.astype(np.int8), [0]))))
    for first, end in edges.reshape(-1, 2):
        begin, after = first - inside[0], end - inside[0]
        if sudden is not None:
            back = sudden.between(begin, after)
        else:
            back = bool((_returns(t_s[inside], difference, begin, after) | ~far[first:end].any(axis=0)).all())
        out[first:end] = out[first:end].any() and back
    if not out.any() or out.mean() > _MAX_FRACTION:
        return whole
    rows = np.flatnonzero(out)
    groups = np.split(rows, np.flatnonzero(np.diff(t_s[rows]) > _APART_S) + 1)
    where = ", ".join(
        f"{np.max(apart[g, 0]):.2f} m and {np.degrees(np.max(apart[g, 1])):.0f} deg at {t_s[g[0]]:.0f} s"
        for g in groups[:6]
    )
    what = "an excursion that comes back" if len(groups) == 1 else f"{len(groups)} excursions that come back"
    whose = "localisation" if truth.localised else "truth"
    kept = ~np.isin(whole.stamps_ns, truth.stamps_ns[out])
    return whole.only(kept, f"{what}, {len(rows)} poses, left out ({where}): errors of the {whose}")


class _Sudden(NamedTuple):
    """Test for sudden steps: the robot's reach, times (m,) and truth minus odometry (m, 3) in m, m, rad."""

    reach: Reach
    t_s: Array
    difference: Array

    def between(self, first: int, end: int) -> bool:
        """Return whether poses first to end begin or end with an impossible step while their neighbours agree."""
        if first < 1 or end >= len(self.t_s):
            return False
        slack = self.reach.noise + self.reach.top * (self.t_s[[first, end]] - self.t_s[[first - 1, end - 1]])[:, None]
        steps = self._apart([first, end], [first - 1, end - 1])
        stays = self._apart([end], [first - 1])
        largest = self._apart(range(first, end), [first - 1]).max(axis=0)
        return bool((steps > slack).any() and (stays < np.maximum(_MAX_LEFT * largest, _MIN_APART)).all())

    def _apart(self, one: Sequence[int], other: Sequence[int]) -> Array:
        moved = self.difference[one] - self.difference[other]
        return np.stack((np.linalg.norm(moved[:, :2], axis=1), np.abs(moved[:, 2])), axis=1)


def _departures(
    odometry: Samples, own_s: Array, truth: Samples, t_s: Array, inside: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Return departures from the running medians of truth minus odometry (m, 2), and the difference (m, 3); m, rad."""
    at = t_s[inside]
    heading = np.interp(at, own_s, np.unwrap(odometry.yaw_rad))
    turned, calm = _unwrapped(truth.yaw_rad[inside] - heading)
    way = np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(odometry.xyz[:, :2], axis=0), axis=1))))
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
    returns: NDArray[np.bool_] = stays < np.maximum(_MAX_LEFT * away, _MIN_APART)
    return returns


def _unwrapped(difference: Array) -> tuple[Array, Array]:
    """Return a difference of headings (n,) unwrapped across flips by half a turn, with and without the flips."""
    steps = wrap(np.diff(difference))
    steps[np.abs(steps) > _FLIP_RAD] = 0.0
    calm = difference[0] + np.concatenate(([0.0], np.cumsum(steps)))
    return calm + wrap(difference - calm), calm


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

"""Returns of moving objects, such as people: sweeps half a metre before or later see through the place of each.

A person who walks with the robot is near, gives many returns, and always looks the same. Matching then follows the
person instead of the walls, and the robot seems to stand. The odometry's motion over half a metre is enough to tell
such an object from a box: a box stays where it was.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import between, rotate
from odomcorrupt.geometry.trajectory import distance_along

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.laser.calibrate import Calibration

_APART_M, _APART_S = 0.5, 3.0
"""Travel between two compared sweeps, m, and largest time between them, s, for a robot that stands."""
_GAP_M, _OBJECT_M = 0.3, 0.8
"""Distance between neighbouring returns that separates objects, and largest extent of a person, m. Walls are larger:
they stay even if the odometry between two sweeps is wrong."""
_THROUGH_M = 0.25
"""Distance beyond an object at which another sweep has to see something else, m."""
_BINS, _SAID_SHARE = 360, 0.1
"""Number of bearings at which ranges are compared, and fraction of returns above which a message reports them."""
_BESIDE_RAD, _TURN_SHARE = np.radians(2.0), 0.1
"""Bearings beside an object in which the other sweep must see through as well, rad, and fraction of the turn between
the sweeps added to it: the odometry's turns may be wrong by as much."""


def without_moving(calibration: Calibration) -> Calibration:
    """Return the calibration with sweeps without returns of moving objects, and a message if these are many.

    An object is a group of neighbouring returns of the size of a person at most. It moves if more than half of its
    returns are where one of two sweeps, before and later, saw something farther away, and the other one did not see it.
    """
    sweeps, motion = calibration.sweeps, calibration.motion
    scans, t_s = calibration.deskewing(), sweeps.middle_s(motion.origin_ns)
    poses = motion.laser(t_s)
    tables = [_nearest_by_bearing(scans[row]) for row in range(len(sweeps))]
    kept = []
    for row, (sweep, others) in enumerate(zip(sweeps.sweeps, _compared(t_s, poses), strict=True)):
        moving = _moving(scans[row], [(between(poses[k], poses[row]), tables[k]) for k in others])
        kept.append(sweep.only(~moving) if moving.any() else sweep)
    share = 1.0 - sum(map(len, kept)) / max(sum(map(len, sweeps.sweeps)), 1)
    said = calibration.said
    if share > _SAID_SHARE:
        said = (*said, f"{sweeps.topic}: {share:.0%} of the returns are of moving objects, such as people; left out")
    return replace(calibration, sweeps=replace(sweeps, sweeps=tuple(kept)), said=said)


def _compared(t_s: Array, poses: Array) -> list[list[int]]:
    """Return the rows of the sweeps with which each is compared: one before and one later."""
    gone = distance_along(poses)
    rows = np.arange(len(t_s))
    later = np.minimum(np.searchsorted(gone, gone + _APART_M), np.searchsorted(t_s, t_s + _APART_S))
    before = np.maximum(
        np.searchsorted(gone, gone - _APART_M, side="right"), np.searchsorted(t_s, t_s - _APART_S, side="right")
    )
    pairs = zip(before - 1, later, rows, strict=True)
    return [[int(k) for k in (first, last) if 0 <= k < len(rows) and k != row] for first, last, row in pairs]


def _nearest_by_bearing(xy: Array) -> Array:
    """Return the smallest range at each of `_BINS` bearings, m; infinite without a return."""
    found = np.full(_BINS, np.inf)
    np.minimum.at(found, _bin(xy), np.hypot(xy[:, 0], xy[:, 1]))
    return found


def _bin(xy: Array) -> NDArray[np.int64]:
    bearing = np.arctan2(xy[:, 1], xy[:, 0]) / (2.0 * np.pi)
    return np.floor(bearing * _BINS).astype(np.int64) % _BINS


def _moving(xy: Array, seen: list[tuple[Array, Array]]) -> NDArray[np.bool_]:
    """Return whether each return (m, 2) is of a moving object.

    seen : for each compared sweep, the pose (3,) of this sweep in its frame, and its ranges by bearing
    """
    through, stays = np.zeros((2, len(xy)), dtype=bool)
    for relative, table in seen:
        there = relative[:2] + rotate(xy, np.full(len(xy), relative[2]))
        width = int(np.ceil((_BESIDE_RAD + _TURN_SHARE * abs(float(relative[2]))) * _BINS / (2.0 * np.pi)))
        around = (_bin(there)[:, None] + np.arange(-width, width + 1)) % _BINS
        beyond = table[around].min(axis=1) - np.hypot(there[:, 0], there[:, 1])
        through |= np.isfinite(beyond) & (beyond > _THROUGH_M)
        stays |= np.abs(beyond) <= _THROUGH_M
    through &= ~stays
    if not through.any():
        return through
    moving = np.zeros(len(xy), dtype=bool)
    for object_ in _objects(xy):
        extent = float(np.linalg.norm(np.ptp(xy[object_], axis=0)))
        moving[object_] = extent < _OBJECT_M and np.mean(through[object_]) > 0.5
    return moving


def _objects(xy: Array) -> list[NDArray[np.int64]]:
    """Return the indices of the returns of each object; one object may contain both the first and the last return."""
    cuts = np.flatnonzero(np.linalg.norm(np.diff(xy, axis=0), axis=1) > _GAP_M) + 1
    parts = np.split(np.arange(len(xy)), cuts)
    if len(parts) > 1 and float(np.linalg.norm(xy[0] - xy[-1])) < _GAP_M:
        parts = [np.concatenate((parts[-1], parts[0])), *parts[1:-1]]
    return parts

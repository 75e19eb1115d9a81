"""Trajectory by the laser: each sweep relocalised in the finished map, with the covariance of its match."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.geometry.se2 import compose, inverse, rotate
from odomcorrupt.laser.icp import WEAK, match, thinned

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.laser.calibrate import Calibration
    from odomcorrupt.laser.slam import Tracked
    from odomcorrupt.laser.sweep import Sweeps

_QUERY = 450
_OVERLAP = 0.35
_GATES_M = (0.2, 0.15)
UNKNOWN_M = 2.0
"""Standard deviation along an axis that the scan does not determine, m."""


@dataclass(frozen=True, slots=True)
class LaserPath:
    """Poses of the robot from its laser.

    row : (k,) index of the sweep of each pose
    t_s : (k,) middle of that sweep on the laser's clock, seconds since the origin
    xyt : (k, 3) poses of the robot in the map, m and rad
    laser_xyt : (k, 3) poses of the laser in the map
    covariance : (k, 3, 3) of each pose in the robot's axes, from the match; `UNKNOWN_M` along an undetermined axis
    part : (k,) index of the connected part of the map
    weak : (k,) whether the match does not determine the position along one axis
    ratio : (k,) smaller over larger eigenvalue of the information of each position
    deviation_m : median deviation of returns from the map's surfaces, m
    """

    row: NDArray[np.int64]
    t_s: Array
    xyt: Array
    laser_xyt: Array
    covariance: Array
    part: NDArray[np.int64]
    weak: NDArray[np.bool_]
    ratio: Array
    deviation_m: float

    def __len__(self) -> int:
        return len(self.row)

    def only(self, kept: NDArray[np.bool_]) -> LaserPath:
        """Return the poses selected by a mask (k,)."""
        arrays = ("row", "t_s", "xyt", "laser_xyt", "covariance", "part", "weak", "ratio")
        return replace(self, **{name: getattr(self, name)[kept] for name in arrays})


class WhiteNoise(NamedTuple):
    """Ratios of position and heading variances to those of the matches, and standard deviation of the stamps, s."""

    position: float
    heading: float
    stamps_s: float


@dataclass(frozen=True, slots=True)
class LaserRun:
    """One run with its trajectory by the laser.

    odometry : as recorded
    sweeps, calibration, tracked, path : laser sweeps, mounting and clock, the map, and the trajectory in it
    noise : noise of the trajectory relative to its matches' covariances
    """

    odometry: Trajectory
    sweeps: Sweeps
    calibration: Calibration
    tracked: Tracked
    path: LaserPath
    noise: WhiteNoise


def relocalised(
    calibration: Calibration, tracked: Tracked, progress: Callable[[float], None] | None = None
) -> LaserPath:
    """Return each sweep's pose in the finished map; sweeps that do not match are left out."""
    motion, world = calibration.motion, tracked.map
    part_of = world.parts()
    scans = calibration.deskewing()
    rows, poses, covariances, parts, weak, ratios, deviations = [], [], [], [], [], [], []
    tracked_rows = np.flatnonzero(tracked.keyframe >= 0)
    for done, n in enumerate(tracked_rows):
        if progress is not None and done % 50 == 0:
            progress(done / len(tracked_rows))
        k = int(tracked.keyframe[n])
        found = match(thinned(scans[int(n)], _QUERY), world.local(k), tracked.relative[n], _GATES_M)
        if found is None or found.overlap < _OVERLAP:
            continue
        covariance = np.linalg.inv(found.information + np.diag([1e-4, 1e-4, 1e-4]))
        unseen = found.ratio < WEAK
        if unseen:
            covariance[:2, :2] += UNKNOWN_M**2 * np.outer(found.weak_axis, found.weak_axis)
        # rotate into the laser's axes, then the robot's
        turn = np.eye(3)
        turn[:2, :2] = rotate(np.eye(2), np.full(2, found.pose[2] - motion.mount[2]))
        rows.append(n)
        poses.append(compose(world.poses[k], found.pose))
        covariances.append(turn @ covariance @ turn.T)
        parts.append(part_of[k])
        weak.append(unseen)
        ratios.append(found.ratio)
        deviations.append(found.deviation_m)
    laser = np.array(poses).reshape(-1, 3)
    xyt = compose(laser, inverse(motion.mount))
    xyt[:, 2] = np.unwrap(xyt[:, 2])
    return LaserPath(
        row=np.array(rows, dtype=np.int64),
        t_s=tracked.t_s[rows],
        xyt=xyt,
        laser_xyt=laser,
        covariance=np.array(covariances).reshape(-1, 3, 3),
        part=np.array(parts, dtype=np.int64),
        weak=np.array(weak, dtype=bool),
        ratio=np.array(ratios),
        deviation_m=float(np.median(deviations)) if deviations else 0.0,
    )

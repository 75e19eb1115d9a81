"""Deskewing: sweeps corrected for the robot's motion during each sweep."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import between, compose

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.laser.sweep import Sweeps

_KNOTS = 17
"""Number of poses per sweep, odd so that the middle is one of them; motion between them is uniform. With 5 in 0.2 s,
heading errors are 2e-4 s^2 times the angular acceleration, which resembles slip at starts and stops."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Odometry as a function of the laser's time.

    lag_s : offset added to the laser's times to get the odometry's, seconds
    mount : (3,) the laser's pose on the robot, m and rad
    turn_ratio : turns of the laser divided by those of the odometry. If the odometry's turns are 4 % wrong, a return
        3 m away is displaced by 1 cm within a sweep at 1 rad/s. This resembles slip to the side, and a scale that
        differs between directions
    """

    odometry: Trajectory
    origin_ns: int
    lag_s: float
    mount: Array
    turn_ratio: float = 1.0

    def robot(self, t_s: Array) -> Array:
        """Return the odometry's poses (n, 3) at times (n,) of the laser; held at both ends."""
        own = self.odometry.seconds_since(self.origin_ns)
        return self.odometry.at(np.clip(t_s + self.lag_s, own[0], own[-1]), self.origin_ns)

    def laser(self, t_s: Array) -> Array:
        """Return the laser's poses (n, 3) in the odometry's frame at times (n,) of the laser."""
        return compose(self.robot(t_s), self.mount)


class Deskewing:
    """Sweeps corrected for motion: each return is moved to its position relative to the laser at the sweep's middle.

    The laser's poses within all chosen sweeps are interpolated in one call, which is much faster than one by one.

    turn_s : see `Calibration`; the time of the middle of each sweep is unchanged
    rows : (k,) indices of the sweeps that will be used; all by default
    """

    def __init__(
        self,
        sweeps: Sweeps,
        motion: Motion,
        *,
        mirrored: bool,
        turn_s: float = 0.0,
        rows: NDArray[np.int64] | None = None,
    ) -> None:
        self._sweeps, self._mirrored, self._turn_s = sweeps.sweeps, mirrored, turn_s
        rows = np.arange(len(sweeps)) if rows is None else np.unique(rows)
        self._place = {int(row): place for place, row in enumerate(rows)}
        spans = np.array([self._span(int(row)) for row in rows]).reshape(-1, 2)
        stamps_s = (sweeps.stamps_ns[rows] - motion.origin_ns).astype(np.float64) * 1e-9
        self._knots_s = spans[:, :1] + (spans[:, 1:] - spans[:, :1]) * (np.arange(_KNOTS) / (_KNOTS - 1.0))
        poses = motion.laser((stamps_s[:, None] + self._knots_s).ravel()).reshape(-1, _KNOTS, 3)
        middle = np.repeat(poses[:, _KNOTS // 2], _KNOTS, axis=0)
        self._relative = between(middle, poses.reshape(-1, 3)).reshape(-1, _KNOTS, 3) * (1.0, 1.0, motion.turn_ratio)

    def __getitem__(self, row: int) -> Array:
        """Return the corrected returns (m, 2) of a sweep, m."""
        sweep, place = self._sweeps[row], self._place[row]
        xy = sweep.xy.astype(np.float64)
        if self._mirrored:
            xy[:, 1] = -xy[:, 1]
        knots_s = self._knots_s[place]
        if knots_s[0] == knots_s[-1]:
            return xy
        after_s = self._after_s(row)
        relative = self._relative[place]
        x, y, yaw = (np.interp(after_s, knots_s, relative[:, i]) for i in range(3))
        c, s = np.cos(yaw), np.sin(yaw)
        return np.stack((x + c * xy[:, 0] - s * xy[:, 1], y + s * xy[:, 0] + c * xy[:, 1]), axis=1)

    def _after_s(self, row: int) -> Array:
        """Return the times (m,) of a sweep's returns after its stamp, seconds."""
        sweep = self._sweeps[row]
        after_s = sweep.after_s.astype(np.float64)
        if self._turn_s == 0.0 or not len(after_s):
            return after_s
        bearing = np.unwrap(np.arctan2(sweep.xy[:, 1].astype(np.float64), sweep.xy[:, 0].astype(np.float64)))
        middle_s = 0.5 * (after_s[0] + after_s[-1])
        return middle_s + (bearing - 0.5 * (bearing[0] + bearing[-1])) * (self._turn_s / (2.0 * np.pi))

    def _span(self, row: int) -> tuple[float, float]:
        """Return the times of a sweep's first and last return after its stamp, s; zeros if all are simultaneous."""
        after_s = self._after_s(row)
        if not len(after_s) or after_s[0] == after_s[-1]:
            return 0.0, 0.0
        return float(after_s.min()), float(after_s.max())

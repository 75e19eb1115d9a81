"""Odometry increments: relative motion between poses, in the body frame at mid heading."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.geometry.se2 import rotate, wrap

if TYPE_CHECKING:
    from typing import Self

    from odomcorrupt.geometry.se2 import Array

BEARING_MIN_M = 0.05
"""Smallest translation with a meaningful bearing, metres; below it, the turn is split evenly."""


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Increments:
    """n increments in the body frame at mid heading.

    ds_m : (n,) signed travel along the body's x axis, metres; negative in reverse
    dl_m : (n,) travel to the left, metres; zero for a non-holonomic robot
    dtheta_rad : (n,) turn, radians, in [-pi, pi)
    """

    ds_m: Array
    dl_m: Array
    dtheta_rad: Array

    def __len__(self) -> int:
        return len(self.ds_m)

    @classmethod
    def of_rows(cls, rows: Array) -> Self:
        """Return the increments of rows (n, 3): ds, dl, dtheta."""
        return cls(*np.ascontiguousarray(rows.T))

    @property
    def rows(self) -> Array:
        """The increments as an array (n, 3)."""
        return np.stack((self.ds_m, self.dl_m, self.dtheta_rad), axis=1)


class RotTransRot(NamedTuple):
    """Increments as turn, drive, turn (Thrun, Burgard & Fox, Probabilistic Robotics, table 5.6); (n,) each.

    trans_m is negative in reverse; rot1_rad is then the turn before driving backwards.
    """

    rot1_rad: Array
    trans_m: Array
    rot2_rad: Array


def increments(xyt: Array) -> Increments:
    """Return the n - 1 increments between n poses (n, 3), metres and radians."""
    dtheta = wrap(np.diff(xyt[:, 2]))
    body = rotate(np.diff(xyt[:, :2], axis=0), -(xyt[:-1, 2] + dtheta / 2.0))
    return Increments(np.ascontiguousarray(body[:, 0]), np.ascontiguousarray(body[:, 1]), dtheta)


def accumulate(start_xyt: Array, steps: Increments) -> Array:
    """Return the poses (n + 1, 3) reached from a start pose (3,) by n increments; headings are not wrapped.

    The cumulative sums include the start pose, so dividing a path anywhere and continuing from the pose reached gives
    the same bits.
    """
    theta = np.cumsum(np.concatenate((start_xyt[2:3], steps.dtheta_rad)))
    world = rotate(np.stack((steps.ds_m, steps.dl_m), axis=1), theta[:-1] + steps.dtheta_rad / 2.0)
    x = np.cumsum(np.concatenate((start_xyt[0:1], world[:, 0])))
    y = np.cumsum(np.concatenate((start_xyt[1:2], world[:, 1])))
    return np.stack((x, y, theta), axis=1)


def rot_trans_rot(steps: Increments) -> RotTransRot:
    """Return increments as turn, drive, turn.

    The bearing is used only for translations of at least `BEARING_MIN_M`; below, rot1 = rot2 = dtheta / 2 and trans
    keeps the sign of ds. If the bearing points backwards (|rot1| > pi/2), rot1 is turned by pi and trans is negative:
    guards on rot1 alone turn slow reverse motion into forward motion (ros-planning/navigation #746).
    """
    trans = np.hypot(steps.ds_m, steps.dl_m)
    half = steps.dtheta_rad / 2.0
    rot1 = wrap(np.arctan2(steps.dl_m, steps.ds_m) + half)
    backwards = np.abs(rot1) > np.pi / 2.0
    rot1 = np.where(backwards, wrap(rot1 + np.pi), rot1)
    far = trans >= BEARING_MIN_M
    sign = np.where(far, np.where(backwards, -1.0, 1.0), np.where(steps.ds_m < 0.0, -1.0, 1.0))
    rot1 = np.where(far, rot1, half)
    return RotTransRot(rot1, sign * trans, wrap(steps.dtheta_rad - rot1))

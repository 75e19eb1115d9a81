"""Poses of SE(2), and odometry increments between them.

A pose is x, y in metres and a heading theta in radians; many poses are an array of shape (n, 3), called `xyt`.
Functions broadcast over leading axes, do not modify their arguments, and do not wrap headings, so that full turns
are counted.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]
    from typing import Self


def wrap(angle_rad: Array) -> Array:
    """Return angles wrapped to [-pi, pi), radians."""
    return angle_rad - 2.0 * np.pi * np.floor(angle_rad / (2.0 * np.pi) + 0.5)


def rotate(xy_m: Array, angle_rad: Array) -> Array:
    """Return vectors (..., 2) rotated by an angle (...), radians."""
    return np.stack(rotated(xy_m[..., 0], xy_m[..., 1], angle_rad), axis=-1)


def rotated(x_m: Array, y_m: Array, angle_rad: Array) -> tuple[Array, Array]:
    """Return the coordinates (...) of vectors x, y (...) rotated by an angle (...), radians.

    For many vectors: NumPy computes with columns several times as fast as with the rows of an array (n, 2).
    """
    # a contiguous copy: sines of strided angles may differ in the last bit
    angle = np.array(angle_rad)
    c, s = np.cos(angle), np.sin(angle)
    return c * x_m - s * y_m, s * x_m + c * y_m


def compose(a_xyt: Array, b_xyt: Array) -> Array:
    """Return the composition a * b of poses (..., 3), b given in the frame of a."""
    a, b = np.broadcast_arrays(a_xyt, b_xyt)
    xy = a[..., :2] + rotate(b[..., :2], a[..., 2])
    return np.concatenate((xy, (a[..., 2] + b[..., 2])[..., None]), axis=-1)


def inverse(a_xyt: Array) -> Array:
    """Return the inverse a^-1 of poses (..., 3)."""
    xy = -rotate(a_xyt[..., :2], -a_xyt[..., 2])
    return np.concatenate((xy, -a_xyt[..., 2:3]), axis=-1)


def between(a_xyt: Array, b_xyt: Array) -> Array:
    """Return the relative pose a^-1 * b, (..., 3): compose(a, between(a, b)) is b. Its heading is not wrapped."""
    xy = rotate(b_xyt[..., :2] - a_xyt[..., :2], -a_xyt[..., 2])
    return np.concatenate((xy, (b_xyt[..., 2] - a_xyt[..., 2])[..., None]), axis=-1)


def interpolate(start_xyt: Array, end_xyt: Array, fraction: Array) -> Array:
    """Return poses (n, 3) on the constant-twist arcs from start to end (interpolation by the SE(2) logarithm).

    start_xyt, end_xyt : (n, 3) poses at the ends, metres and radians; the smaller heading difference is used
    fraction : (n,) 0 at the start, 1 at the end
    """
    step = between(start_xyt, end_xyt)
    turn = wrap(step[..., 2])
    half = turn / 2.0
    # chord of a partial arc: sin(f*h)/sin(h) of the whole, at angle f*h instead of h; np.sinc keeps h = 0 exact
    ratio = fraction * np.sinc(fraction * half / np.pi) / np.sinc(half / np.pi)
    xy = rotate(step[..., :2], (fraction - 1.0) * half) * ratio[..., None]
    return compose(start_xyt, np.concatenate((xy, (fraction * turn)[..., None]), axis=-1))


@np.errstate(over="ignore", invalid="ignore")  # an invalid quaternion gives NaN
def yaw_from_quaternion(quat_xyzw: Array) -> Array:
    """Return the yaw (...) of quaternions xyzw (..., 4) of any non-zero length, radians.

    Yaw of the z-y-x Euler angles: direction of the body's x axis in the horizontal plane. Of an x axis within 6 degrees
    of the vertical it is that of the z axis, forward if x points down, backward if it points up.
    """
    x, y, z, w = np.moveaxis(quat_xyzw, -1, 0)
    across, along, down = 2.0 * (w * z + x * y), w * w + x * x - y * y - z * z, 2.0 * (w * y - x * z)
    if (steep := down * down > 99.0 * (across * across + along * along)).any():
        across, along = np.where(steep, (down * (y * z - w * x), down * (x * z + w * y)), (across, along))
    return np.arctan2(across, along)


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

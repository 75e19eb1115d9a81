"""Planar poses, the group SE(2).

A pose is x, y in metres and a heading theta in radians; many poses are an array of shape (n, 3), called `xyt`.
Functions broadcast over leading axes, do not modify their arguments, and do not wrap headings, so that full turns
are counted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Array = NDArray[np.float64]


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

    Yaw of the z-y-x Euler angles: direction of the body's x axis in the horizontal plane.
    """
    x, y, z, w = np.moveaxis(quat_xyzw, -1, 0)
    return np.arctan2(2.0 * (w * z + x * y), w * w + x * x - y * y - z * z)

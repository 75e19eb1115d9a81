"""Rigid transforms in space, as needed for a chain of TF edges."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.corruption.pose_faults import W_FIRST, ComponentOrder
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import yaw_from_quaternion

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array


_SHORTEST = 1e-6


class Transforms(NamedTuple):
    """Positions (n, 3) in metres and unit quaternions xyzw (n, 4); n may be 1 for a static transform."""

    xyz: Array
    quat_xyzw: Array


def unit(quat_xyzw: Array) -> Array:
    """Return quaternions (n, 4) normalised; NaN for those that are zero or not finite."""
    largest = np.abs(quat_xyzw).max(axis=1, keepdims=True)
    usable = (largest > _SHORTEST) & (largest < np.inf)
    # Scale first: squares of values from a damaged bag could overflow.
    scaled = np.divide(quat_xyzw, largest, out=np.full_like(quat_xyzw, np.nan), where=usable)
    return scaled / np.linalg.norm(scaled, axis=1, keepdims=True)


def headings(quat_xyzw: Array) -> Array:
    """Return the headings (n,) of quaternions (n, 4) of any norm, NaN for invalid ones."""
    return np.asarray(yaw_from_quaternion(unit(quat_xyzw)))


def check_order(place: str, xyz: Array, quat_xyzw: Array) -> None:
    """Refuse quaternions (n, 4) at positions (n, 3) whose components are in the order w, x, y, z."""
    order = ComponentOrder()
    order.take(xyz, quat_xyzw)
    if order.w_first:
        raise RecordingError(f"{place}: {W_FIRST}")


def composed(a: Transforms, b: Transforms) -> Transforms:
    """Return the composition of a and b, with b in the frame of a."""
    av, aw, bv, bw = a.quat_xyzw[:, :3], a.quat_xyzw[:, 3:], b.quat_xyzw[:, :3], b.quat_xyzw[:, 3:]
    scalar = aw * bw - np.sum(av * bv, axis=1, keepdims=True)
    product = np.concatenate((aw * bv + bw * av + np.cross(av, bv), scalar), axis=1)
    return Transforms(a.xyz + _turned(a.quat_xyzw, b.xyz), product)


def inverted(a: Transforms) -> Transforms:
    """Return the inverse transforms."""
    back = a.quat_xyzw * np.array([-1.0, -1.0, -1.0, 1.0])
    return Transforms(-_turned(back, a.xyz), back)


def interpolated(t_s: Array, moving: Transforms, at_s: Array) -> Transforms:
    """Return transforms (m,) at times within t_s (n,), n > 1: linear in position, spherical linear in rotation."""
    left = np.clip(np.searchsorted(t_s, at_s, side="right") - 1, 0, len(t_s) - 2)
    fraction = ((at_s - t_s[left]) / (t_s[left + 1] - t_s[left]))[:, None]
    xyz = moving.xyz[left] + fraction * (moving.xyz[left + 1] - moving.xyz[left])
    start, end = moving.quat_xyzw[left], moving.quat_xyzw[left + 1]
    cosine = np.sum(start * end, axis=1, keepdims=True)
    # q and -q are the same rotation: take the shorter arc.
    end = np.where(cosine < 0.0, -end, end)
    angle = np.arccos(np.clip(np.abs(cosine), 0.0, 1.0))
    whole = np.sinc(angle / np.pi)
    a = (1.0 - fraction) * np.sinc((1.0 - fraction) * angle / np.pi) / whole
    b = fraction * np.sinc(fraction * angle / np.pi) / whole
    return Transforms(xyz, unit(a * start + b * end))


def _turned(quat_xyzw: Array, xyz: Array) -> Array:
    axis, w = quat_xyzw[:, :3], quat_xyzw[:, 3:]
    once = 2.0 * np.cross(axis, xyz)
    return xyz + w * once + np.cross(axis, once)

"""Rigid transforms in space, as needed for a chain of TF edges."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from odomcorrupt.geometry.se2 import yaw_from_quaternion

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array


_SHORTEST = 1e-6


class Transforms(NamedTuple):
    """Positions (n, 3) in metres and n rotations; n may be 1 for a static transform."""

    xyz: Array
    rotation: Rotation

    def only(self, rows: NDArray[np.int64] | slice) -> Transforms:
        """Return some of the transforms."""
        return Transforms(self.xyz[rows], self.rotation[rows])


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


def composed(a: Transforms, b: Transforms) -> Transforms:
    """Return the composition of a and b, with b in the frame of a."""
    return Transforms(a.xyz + a.rotation.apply(b.xyz), a.rotation * b.rotation)


def inverted(a: Transforms) -> Transforms:
    """Return the inverse transforms."""
    back = a.rotation.inv()
    return Transforms(-back.apply(a.xyz), back)


def interpolated(t_s: Array, moving: Transforms, at_s: Array) -> Transforms:
    """Return transforms (m,) at times within t_s (n,), n > 1: linear in position, spherical linear in rotation."""
    xyz = np.column_stack([np.interp(at_s, t_s, column) for column in moving.xyz.T])
    return Transforms(xyz, Slerp(t_s, moving.rotation)(at_s))

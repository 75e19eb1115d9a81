"""Planar corrections (SE(2)) applied to spatial poses (SE(3)); z, roll and pitch are kept."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.messages import gather
from odomcorrupt.geometry.se2 import rotate, rotated, wrap, yaw_from_quaternion

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Block
    from odomcorrupt.bags.messages import Item, Layout
    from odomcorrupt.geometry.se2 import Array


PLANAR = np.array([0, 1, 5])
"""Where x, y and yaw stand among x, y, z, roll, pitch, yaw."""


class SpatialPoses(NamedTuple):
    """n poses: position (n, 3) in metres, quat_xyzw (n, 4) of any length but zero; fastest with contiguous columns."""

    position: Array
    quat_xyzw: Array


def poses_in(block: Block, layout: Layout, item: Item) -> SpatialPoses:
    """Return the poses (n,) of the messages of a layout."""
    begin, _ = item.fields["position"]
    columns = gather(block, layout, item._replace(fields={"pose": (begin, 7)}), "pose").T.copy()
    return SpatialPoses(columns[:3].T, columns[3:].T)


def finite_rows(values: Array) -> NDArray[np.bool_]:
    """Return a mask (n,) of the rows of values (n, k) that are finite; fast where all are."""
    finite = np.isfinite(values)
    return np.ones(len(values), dtype=bool) if finite.all() else np.asarray(finite.all(axis=1))


def planar_poses(poses: SpatialPoses) -> Array:
    """Return x, y and heading (n, 3) of poses; the heading of a quaternion of four zeros is NaN."""
    x, y, _ = poses.position.T
    yaw = yaw_from_quaternion(poses.quat_xyzw)
    if not (oriented := poses.quat_xyzw.any(axis=1)).all():
        yaw = np.where(oriented, yaw, np.nan)
    return np.stack((x, y, yaw)).T


def from_left(correction_xyt: Array, poses: SpatialPoses) -> SpatialPoses:
    """Return C * pose, (n,): poses whose parent frame has moved by C (n, 3), metres and radians."""
    (px, py, pz), (x, y, z, w), (dx, dy, turn) = poses.position.T, poses.quat_xyzw.T, correction_xyt.T
    px, py = rotated(px, py, turn)
    half = turn / 2.0
    c, s = np.cos(half), np.sin(half)
    quat = np.stack((c * x - s * y, c * y + s * x, c * z + s * w, c * w - s * z))
    return SpatialPoses(np.stack((px + dx, py + dy, pz)).T, quat.T)


def from_right(correction_xyt: Array, poses: SpatialPoses) -> SpatialPoses:
    """Return pose * C^-1, (n,): poses whose child frame has moved by C (n, 3), metres and radians."""
    half = correction_xyt[:, 2] / 2.0
    c, s = np.cos(half), -np.sin(half)
    x, y, z, w = poses.quat_xyzw.T
    quat = np.stack((c * x + s * y, c * y - s * x, c * z + s * w, c * w - s * z), axis=1)
    back = np.zeros_like(poses.position)
    back[:, :2] = -rotate(correction_xyt[:, :2], -correction_xyt[:, 2])
    return SpatialPoses(poses.position + _turned(poses.quat_xyzw, back), quat)


def inverted(poses: SpatialPoses) -> SpatialPoses:
    """Return the inverse transforms."""
    back = poses.quat_xyzw * np.array([-1.0, -1.0, -1.0, 1.0])
    return SpatialPoses(-_turned(back, poses.position), back)


def tilted_rows(quat_xyzw: Array) -> NDArray[np.int64]:
    """Return the rows of orientations (n, 4) whose z axis is not vertical, or points down."""
    return np.flatnonzero((quat_xyzw[:, 0] != 0.0) | (quat_xyzw[:, 1] != 0.0))


def tilts(quat_xyzw: Array, yaw_rad: Array) -> Array:
    """Return the rotations (n, 3, 3) from the child frames into their level frames, which have the same heading.

    Columns are the axes of the child frame. `yaw_rad` (n,) is the heading of orientations quat_xyzw (n, 4).
    """
    half = yaw_rad / 2.0
    c, s = np.cos(half), np.sin(half)
    x, y, z, w = quat_xyzw.T
    tilt = np.stack((c * x + s * y, c * y - s * x, c * z - s * w, c * w + s * z), axis=1)
    return np.stack([_turned(tilt, np.broadcast_to(axis, (len(tilt), 3))) for axis in np.eye(3)], axis=2)


def turns_about_vertical(quat_xyzw: Array) -> Array | None:
    """Return the turns (n - 1,) between orientations (n, 4), radians; None if all are level, as headings tell then."""
    if not len(tilted_rows(quat_xyzw)):
        return None
    (a, b, c, d), (x, y, z, w) = quat_xyzw[:-1].T, quat_xyzw[1:].T
    return wrap(2.0 * np.arctan2(d * z - c * w + a * y - b * x, a * x + b * y + c * z + d * w))


def in_level_frame(twist: Array, quat_xyzw: Array, yaw_rad: Array) -> Array:
    """Return twists (n, 6) of the child frame in the axes of its level frame; parameters as of `tilts`."""
    rows = tilted_rows(quat_xyzw)
    if not len(rows):
        return twist
    turn, out = tilts(quat_xyzw[rows], yaw_rad[rows]), twist.copy()
    out[rows] = (turn[:, None] @ twist[rows].reshape(-1, 2, 3, 1)).reshape(-1, 6)
    return out


def _turned(quat_xyzw: Array, vector: Array) -> Array:
    """Return vectors (n, 3) rotated by quaternions xyzw (n, 4) of any length but zero."""
    axis, w = quat_xyzw[:, :3], quat_xyzw[:, 3:]
    length2 = (quat_xyzw * quat_xyzw).sum(axis=1, keepdims=True)
    once = np.cross(axis, vector)
    return vector + 2.0 * (w * once + np.cross(axis, once)) / length2

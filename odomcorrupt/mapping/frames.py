"""Poses of frames on a robot, and of a map in the odom frame, from TF messages without ROS."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import TRANSFORMS, gather, gather_stamps_ns, locate
from odomcorrupt.corruption.odometry_source import plain
from odomcorrupt.errors import TopicError
from odomcorrupt.geometry.se2 import rotate

if TYPE_CHECKING:
    from collections.abc import Iterable

    from odomcorrupt.bags.block import Block, Channel
    from odomcorrupt.geometry.se2 import Array


@dataclass(frozen=True, slots=True)
class Mount:
    """Pose of a laser on the robot.

    position_xy : (2,) in the robot's frame, metres
    plane : (2, 2) rotation of directions from the laser's plane to the robot's; mirrored if mounted upside down
    """

    position_xy: Array
    plane: Array


def mount_at(xyt: Array) -> Mount:
    """Return an upright mount at a pose (3,)."""
    return Mount(xyt[:2].copy(), rotate(np.eye(2), xyt[2]).T)


class FrameTree:
    """Transforms of a bag: the first one of every edge, static topics before others."""

    def __init__(self) -> None:
        self._static: dict[str, tuple[str, Array]] = {}
        self._moving: dict[str, tuple[str, Array]] = {}

    def take(self, block: Block, channels: Iterable[Channel]) -> None:
        """Read the transforms of a block."""
        for channel in channels:
            if channel.msgtype not in TRANSFORMS:
                continue
            edges = self._static if plain(channel.topic).endswith("tf_static") else self._moving
            for layout in locate(block, channel):
                for item in layout.items:
                    child, parent = plain(item.child_frame_id), plain(item.frame_id)
                    if child in edges:
                        continue
                    first = int(np.argmin(gather_stamps_ns(block, layout, item)))
                    position = gather(block, layout, item, "position")[first]
                    quat = gather(block, layout, item, "orientation")[first]
                    edges[child] = (parent, _matrix(position, quat))

    def mount(self, base: str, laser: str, bag: str) -> Mount:
        """Return the pose of a laser on the robot; TopicError if TF does not contain it."""
        whole = self._between(plain(base), plain(laser))
        if whole is None:
            known = ", ".join(sorted({*self._static, *self._moving})) or "nothing"
            raise TopicError(
                f"{bag}: TF does not lead from {plain(base)!r} to the laser's frame {plain(laser)!r} (TF contains "
                f"{known}); give the laser's pose on the robot with --laser-pose x,y,yaw"
            )
        return Mount(whole[:2, 3].copy(), whole[:2, :2].copy())

    def pose(self, parent: str, child: str) -> Array | None:
        """Return the planar pose (3,) of a frame in another; None if TF does not contain it."""
        whole = self._between(plain(parent), plain(child))
        if whole is None:
            return None
        return np.array([whole[0, 3], whole[1, 3], np.arctan2(whole[1, 0], whole[0, 0])])

    def _between(self, frame: str, other: str) -> Array | None:
        """Return the pose (4, 4) of one frame in another."""
        up_frame, up_other = self._ancestors(frame), self._ancestors(other)
        shared = next((name for name in up_other if name in up_frame), None)
        if shared is None:
            return None
        return np.linalg.inv(up_frame[shared]) @ up_other[shared]

    def _ancestors(self, frame: str) -> dict[str, Array]:
        """Return the ancestors of a frame, the nearest first, with the pose (4, 4) of the frame in each."""
        pose: Array = np.eye(4)
        found = {frame: pose}
        while (edge := self._static.get(frame, self._moving.get(frame))) is not None:
            frame = edge[0]
            if frame in found:
                break
            pose = edge[1] @ pose
            found[frame] = pose
        return found


def _matrix(position: Array, quat_xyzw: Array) -> Array:
    norm = float(np.sqrt(quat_xyzw @ quat_xyzw))
    x, y, z, w = quat_xyzw / norm if norm > 0.0 else np.array([0.0, 0.0, 0.0, 1.0])
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w), position[0]],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w), position[1]],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y), position[2]],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )

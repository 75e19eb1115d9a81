"""Laser scans, clouds and maps in a bag, and the pose of a laser on the robot from TF.

Messages are untrusted: every count is checked against the bytes present before memory is allocated.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.bags.messages import SCAN, SECOND_NS, TRANSFORMS, cursor_of, gather, gather_stamps_ns, locate
from odomcorrupt.bags.open import open_reader
from odomcorrupt.corruption.odometry_source import plain
from odomcorrupt.errors import BagError, TopicError
from odomcorrupt.geometry.se2 import rotate, yaw_from_quaternion

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Block, Channel
    from odomcorrupt.bags.messages import Cursor
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


GRID = "nav_msgs/msg/OccupancyGrid"
CLOUD = "sensor_msgs/msg/PointCloud2"
_CLOUD_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 8: "f8"}


@dataclass(frozen=True, slots=True)
class ScanMessage:
    """A sensor_msgs/LaserScan: angles in radians, distances in metres, times in seconds; ranges_m (n,)."""

    stamp_ns: int
    frame_id: str
    angle_min: float
    angle_step: float
    time_step_s: float
    range_min_m: float
    range_max_m: float
    ranges_m: Array
    scan_time_s: float = 0.0


@dataclass(frozen=True, slots=True)
class CloudMessage:
    """A sensor_msgs/PointCloud2: positions (n, 3) in metres, and times (n,) since the first of them, seconds."""

    stamp_ns: int
    frame_id: str
    xyz: Array
    after_s: Array


@dataclass(frozen=True, slots=True)
class GridMessage:
    """A nav_msgs/OccupancyGrid: cells (rows, columns) of -1 or 0..100, the first row at the origin."""

    frame_id: str
    resolution_m: float
    origin_xyt: Array
    cells: NDArray[np.int8]


def _header(cursor: Cursor) -> tuple[int, str]:
    """Read a std_msgs/Header: stamp, nanoseconds, and frame."""
    at, frame = cursor.header()
    seconds, nanoseconds = struct.unpack_from(cursor.order + cursor.stamp_kind, cursor.data, at)
    return seconds * SECOND_NS + nanoseconds, frame


def read_scan(data: bytes, topic: str, encoding: str) -> ScanMessage:
    """Read a laser scan."""
    cursor = cursor_of(data, topic, encoding, "")
    stamp_ns, frame = _header(cursor)
    first, _, step, time_step, scan_time, nearest, farthest = cursor.numbers("f", 7)
    ranges = cursor.sequence("f4").astype(np.float64)
    return ScanMessage(stamp_ns, frame, first, step, time_step, nearest, farthest, ranges, scan_time)


def read_cloud(data: bytes, topic: str, encoding: str) -> CloudMessage:
    """Read the positions and, if present, the times of a point cloud.

    Raises
    ------
    BagError
        If the message is damaged, or has no x, y and z of 4 or 8 bytes.
    """
    cursor = cursor_of(data, topic, encoding, "")
    stamp_ns, frame = _header(cursor)
    height, width = cursor.numbers("I", 2)
    fields = {}
    for _ in range(cursor.count()):
        name, (offset,), (kind,), _ = cursor.string(), cursor.numbers("I"), cursor.numbers("B"), cursor.numbers("I")
        fields[name] = (offset, _CLOUD_KINDS.get(kind, ""))
    order = ">" if cursor.numbers("B")[0] else "<"
    step, _ = cursor.numbers("I", 2)
    raw = cursor.sequence("u1")
    if not all(fields.get(name, (0, ""))[1] in ("f4", "f8") for name in "xyz"):
        found = ", ".join(fields) or "none"
        raise BagError(f"{topic}: a point cloud without x, y, z as floating-point numbers (fields: {found})")
    count = width * height
    beyond = any(offset + np.dtype(kind or "u1").itemsize > step for offset, kind in fields.values())
    if step < 1 or raw.size < count * step or beyond:
        raise BagError(f"{topic}: a cloud of {count} points of {step} bytes carries {raw.size}; the message is damaged")
    table = raw[: count * step].reshape(count, step)

    def column(name: str) -> Array:
        offset, kind = fields[name]
        size = np.dtype(kind).itemsize
        part = np.ascontiguousarray(table[:, offset : offset + size])
        return part.view(order + kind)[:, 0].astype(np.float64)

    xyz = np.stack([column(name) for name in "xyz"], axis=1)
    timed = next((n for n in ("t", "time", "timestamp", "time_offset", "offset_time") if fields.get(n, (0, ""))[1]), "")
    return CloudMessage(stamp_ns, frame, xyz, _after_s(column(timed), fields[timed][1]) if timed else np.zeros(count))


def _after_s(times: Array, kind: str) -> Array:
    """Return seconds since the first point; drivers write seconds, or integer nanoseconds or microseconds."""
    after = times - times.min() if len(times) else times
    last = float(after.max()) if len(after) else 0.0
    unit = 1.0 if kind.startswith("f") and last < 1.0 else 1e-9 if last > 1e6 else 1e-6
    return after * unit


def read_grid(data: bytes, topic: str, encoding: str) -> GridMessage:
    """Read an occupancy grid."""
    cursor = cursor_of(data, topic, encoding, "")
    _, frame = cursor.header()
    cursor.numbers("I", 2)  # map_load_time
    resolution = cursor.numbers("f")[0]
    width, height = cursor.numbers("I", 2)
    pose = np.array(cursor.numbers("d", 7))
    cells = cursor.sequence("i1").astype(np.int8)
    if cells.size != width * height:
        raise BagError(f"{topic}: a grid of {width} x {height} cells carries {cells.size}; the message is damaged")
    if not (np.isfinite(pose).all() and np.isfinite(resolution) and resolution > 0.0 and np.any(pose[3:])):
        raise BagError(f"{topic}: a grid with resolution {resolution} and origin {pose[:2]}; the message is damaged")
    origin = np.array([pose[0], pose[1], float(yaw_from_quaternion(pose[3:]))])
    return GridMessage(frame, float(resolution), origin, cells.reshape(height, width))


class Lasers(NamedTuple):
    """All messages of one laser, with the log time of each, ns; names of bag and topic; the transforms of the bag."""

    messages: list[ScanMessage | CloudMessage]
    log_ns: NDArray[np.int64]
    place: str
    topic: str
    tree: FrameTree


def read_lasers(path: Path, topic: str | None, kinds: Sequence[str], place: str | None = None) -> Lasers:
    """Return the messages of a topic of a bag, or of the only one of the first of these types that there is.

    place : name of the bag for messages

    Raises
    ------
    TopicError
        If there is no such topic, or the choice is ambiguous.
    """
    tree, messages, logs = FrameTree(), [], []
    with open_reader(path) as reader:
        place = place or reader.name
        channels = _choose(list(reader.channels.values()), topic, kinds, place)
        read = read_scan if channels[0].msgtype == SCAN else read_cloud
        for block in reader.blocks():
            tree.take(block, reader.channels.values())
            for channel in channels:
                for row in block.table[block.table["channel"] == channel.id]:
                    data = block.data[row["offset"] : row["offset"] + row["length"]].tobytes()
                    messages.append(read(data, channel.topic, channel.encoding))
                    logs.append(int(row["log_ns"]))
    return Lasers(messages, np.array(logs, dtype=np.int64), place, channels[0].topic, tree)


def _choose(channels: list[Channel], topic: str | None, kinds: Sequence[str], place: str) -> list[Channel]:
    lasers = [c for c in channels if c.msgtype in kinds]
    names = " or ".join(kind.replace("/msg/", "/") for kind in kinds)
    if topic is not None:
        chosen = [c for c in lasers if plain(c.topic) == plain(topic)]
        if not chosen:
            found = ", ".join(sorted({c.topic for c in lasers})) or "none"
            raise TopicError(f"{place}: no {names} on {topic} (found {found}); name another with --scan")
        return chosen
    for kind in kinds:
        topics = sorted({c.topic for c in lasers if c.msgtype == kind})
        if len(topics) > 1:
            raise TopicError(f"{place}: several lasers: {', '.join(topics)}; name one with --scan")
        if topics:
            return [c for c in lasers if c.topic == topics[0]]
    there = ", ".join(sorted({c.topic for c in channels})) or "no topic at all"
    raise TopicError(f"{place}: no {names} topic (found {there}); record one")

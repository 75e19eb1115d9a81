"""Trajectories read from a bag: odometry, and poses of any other topic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import gather, locate
from odomcorrupt.bags.open import open_reader
from odomcorrupt.corruption.odometry_source import ODOMETRY, find_odometry, plain, stamps_or_log_ns
from odomcorrupt.errors import RecordingError, TopicError
from odomcorrupt.geometry.se2 import yaw_from_quaternion
from odomcorrupt.geometry.trajectory import Trajectory

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader, Channel
    from odomcorrupt.geometry.se2 import Array

POSES = (ODOMETRY, "geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/PoseWithCovarianceStamped")


@dataclass(frozen=True, slots=True)
class Drive:
    """Odometry of a drive: n messages with strictly increasing stamps.

    frame_id, child_frame_id : as in the first message
    stamps_ns : (n,) header stamps
    xyt : (n, 3) poses, metres and radians, headings unwrapped
    twist : (n, 3) vx, vy in m/s and yaw rate in rad/s, in the robot's frame
    notes : messages left out, one sentence each
    """

    topic: str
    frame_id: str
    child_frame_id: str
    stamps_ns: NDArray[np.int64]
    xyt: Array
    twist: Array
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def t_s(self) -> Array:
        """Seconds since the first stamp (n,)."""
        out: Array = (self.stamps_ns - self.stamps_ns[0]) * np.float64(1e-9)
        return out

    @property
    def distance_m(self) -> Array:
        """Distance travelled (n,) since the first pose, metres."""
        step = np.diff(self.xyt[:, :2], axis=0)
        return np.concatenate(([0.0], np.cumsum(np.hypot(step[:, 0], step[:, 1]))))

    @property
    def trajectory(self) -> Trajectory:
        """The poses without the twists."""
        return Trajectory(self.stamps_ns, self.xyt)


def read_drive(path: Path, topic: str | None) -> Drive:
    """Return the odometry of a bag; topic None: its only odometry topic.

    Raises
    ------
    BagError
        If the bag cannot be read.
    TopicError
        If there is no odometry, or several topics and none was chosen.
    RecordingError
        If there are fewer than two usable messages.
    """
    with open_reader(path) as reader:
        name = find_odometry(reader.channels.values(), topic, reader.name)
        channels = [c for c in reader.channels.values() if c.topic == name and c.msgtype == ODOMETRY]
        return _drive(reader, channels, name)


def read_poses(path: Path, topic: str) -> Trajectory:
    """Return the trajectory of an Odometry, PoseStamped or PoseWithCovarianceStamped topic, in its own frame."""
    with open_reader(path) as reader:
        channels = [c for c in reader.channels.values() if plain(c.topic) == plain(topic)]
        if not channels:
            raise TopicError(f"{reader.name}: no topic {topic} (found {_topics(reader)}); name another one")
        if channels[0].msgtype not in POSES:
            raise TopicError(f"{reader.name}: {topic} is a {channels[0].msgtype}; poses are {', '.join(POSES)}")
        return _drive(reader, channels, topic).trajectory


def find_truth(path: Path) -> str | None:
    """Return the pose topic whose name marks it as ground truth; None if there is none or more than one."""
    with open_reader(path) as reader:
        named = {c.topic for c in reader.channels.values() if c.msgtype in POSES and "truth" in c.topic}
    return named.pop() if len(named) == 1 else None


def _topics(reader: BagReader) -> str:
    return ", ".join(sorted({c.topic for c in reader.channels.values()})) or "nothing"


def _drive(reader: BagReader, channels: list[Channel], topic: str) -> Drive:
    """Return the stamps, poses and twists of the channels of one topic; twists are zero in messages without them."""
    parts: list[tuple[NDArray[np.int64], Array]] = [(np.zeros(0, dtype=np.int64), np.zeros((0, 6)))]
    frames: tuple[str, str] | None = None
    for block in reader.blocks():
        for channel in channels:
            for layout in locate(block, channel):
                item = layout.items[0]
                frames = frames or (item.frame_id, item.child_frame_id)
                xy = gather(block, layout, item, "position")[:, :2]
                yaw = yaw_from_quaternion(gather(block, layout, item, "orientation"))
                twist = np.zeros((len(yaw), 3))
                if "twist" in item.fields:
                    twist = gather(block, layout, item, "twist")[:, [0, 1, 5]]
                parts.append((stamps_or_log_ns(block, layout, 0), np.column_stack((xy, yaw, twist))))
    stamps, numbers = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    good = np.isfinite(numbers).all(axis=1)
    # of messages with equal stamps the last one is used: its twist is the one that continues
    kept, index = np.unique(stamps[good][::-1], return_index=True)
    if len(kept) < 2:
        raise RecordingError(f"{reader.name}: {topic} holds {len(kept)} usable messages; it takes two or more")
    notes = []
    if len(kept) < len(stamps):
        unusable = int(np.count_nonzero(~good))
        notes.append(
            f"{topic}: {unusable} messages without numbers and {int(good.sum()) - len(kept)} duplicates left out"
        )
    numbers = numbers[good][::-1][index]
    xyt = numbers[:, :3].copy()
    xyt[:, 2] = np.unwrap(xyt[:, 2])
    frame, child = frames or ("", "")
    return Drive(topic, frame, child, kept, xyt, numbers[:, 3:].copy(), tuple(notes))

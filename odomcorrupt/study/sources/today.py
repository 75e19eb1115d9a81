"""Read recordings: a topic of odometry and a topic of truth out of a bag."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import gather, gather_stamps_ns, locate
from odomcorrupt.bags.open import open_reader
from odomcorrupt.errors import RecordingError, TopicError
from odomcorrupt.pose import yaw_from_quaternion
from odomcorrupt.study.trajectory import Recording, Trajectory

if TYPE_CHECKING:
    from pathlib import Path

    from odomcorrupt.bags.block import BagReader, Block, Channel

__all__ = ["ODOMETRY", "TRUTHS", "read_recording"]

ODOMETRY = "nav_msgs/msg/Odometry"
TRUTHS = (
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
    "geometry_msgs/msg/TransformStamped",
    ODOMETRY,
)
"""Message types that can be a truth, the likeliest first."""


def read_recording(
    path: Path, odom_topic: str | None, truth_topic: str | None, *, track_m: float | None = None
) -> Recording:
    """Read one run.

    Parameters
    ----------
    path : a bag with both topics
    odom_topic, truth_topic : names; None takes the only topic that can be meant
    track_m : nominal distance between the wheels, where it is known

    Raises
    ------
    TopicError
        Where a topic is missing or several could be meant; the message lists them.
    RecordingError
        Where there are too few poses, or none that is a number.

    """
    with open_reader(path) as reader:
        odometry = _choose(reader, path, odom_topic, (ODOMETRY,), "odometry", "--odom", ())
        truth = _choose(reader, path, truth_topic, TRUTHS, "truth", "--truth", (odometry.topic,))
        collected = {channel.id: _Poses(channel) for channel in (odometry, truth)}
        for block in reader.blocks():
            for poses in collected.values():
                poses.take(block)
    notes: list[str] = []
    first = collected[odometry.id].trajectory(path, notes)
    second = collected[truth.id].trajectory(path, notes)
    return Recording(path.name, first, second, int(first.stamps_ns[0]), track_m, tuple(notes))


def _choose(
    reader: BagReader,
    path: Path,
    topic: str | None,
    types: tuple[str, ...],
    what: str,
    flag: str,
    not_these: tuple[str, ...],
) -> Channel:
    channels = [c for c in reader.channels.values() if c.topic not in not_these]
    if topic is not None:
        for channel in channels:
            if channel.topic == topic:
                if channel.msgtype not in types:
                    raise TopicError(f"{path}: {topic} is a {channel.msgtype}; {what} can be {', '.join(types)}")
                return channel
        there = ", ".join(sorted({c.topic for c in channels})) or "nothing"
        raise TopicError(f"{path}: no topic {topic} (found {there}). Name another with {flag}.")
    fitting = {c.topic: c for c in channels if c.msgtype in types}
    if what == "truth" and len(fitting) > 1:
        named = {t: c for t, c in fitting.items() if "truth" in t}
        fitting = named or fitting
    if len(fitting) == 1:
        return next(iter(fitting.values()))
    if not fitting:
        there = ", ".join(sorted({f"{c.topic} ({c.msgtype})" for c in channels})) or "nothing"
        raise TopicError(f"{path}: no topic that could be {what} (found {there}). Name one with {flag}.")
    raise TopicError(f"{path}: several topics could be {what}: {', '.join(sorted(fitting))}. Name one with {flag}.")


class _Poses:
    """Poses of one channel while a bag is read."""

    def __init__(self, channel: Channel) -> None:
        self.channel = channel
        self.stamps: list[np.ndarray] = []
        self.logs: list[np.ndarray] = []
        self.xyt: list[np.ndarray] = []

    def take(self, block: Block) -> None:
        for layout in locate(block, self.channel):
            item = layout.items[0]
            xy = gather(block, layout, item, "position")[:, :2]
            yaw = yaw_from_quaternion(gather(block, layout, item, "orientation"))
            self.stamps.append(gather_stamps_ns(block, layout, item))
            self.logs.append(block.table["log_ns"][layout.rows])
            self.xyt.append(np.concatenate((xy, yaw[:, None]), axis=1))

    def trajectory(self, path: Path, notes: list[str]) -> Trajectory:
        """Return the poses in order of their stamps, unusable ones left out and counted."""
        topic = self.channel.topic
        if not self.stamps:
            raise RecordingError(f"{path}: {topic} holds no message; name another topic")
        stamps, xyt = np.concatenate(self.stamps), np.concatenate(self.xyt)
        if not stamps.any():
            stamps = np.concatenate(self.logs)
            notes.append(f"{topic}: no header stamps, log times taken")
        good = np.isfinite(xyt).all(axis=1)
        if not good.all():
            notes.append(f"{topic}: {np.sum(~good)} poses that are no numbers left out")
            stamps, xyt = stamps[good], xyt[good]
        swapped = int(np.sum(np.diff(stamps) < 0))
        unique, index = np.unique(stamps, return_index=True)
        repeats = len(stamps) - len(unique)
        if swapped or repeats:
            notes.append(f"{topic}: {swapped} stamps out of order sorted, {repeats} repeats left out")
        if len(unique) < 2:
            raise RecordingError(f"{path}: {topic} holds {len(unique)} usable poses; it takes many more")
        xyt = xyt[index].copy()
        xyt[:, 2] = np.unwrap(xyt[:, 2])
        return Trajectory(unique, xyt)

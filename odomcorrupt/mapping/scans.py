"""Laser scans of a bag, as rays in the robot's frame with individual times."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.open import open_reader
from odomcorrupt.errors import RecordingError, TopicError
from odomcorrupt.mapping.frames import FrameTree, Mount
from odomcorrupt.mapping.messages import SCAN, ScanMessage, read_scan

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Channel
    from odomcorrupt.geometry.se2 import Array


@dataclass(frozen=True, slots=True)
class Rays:
    """n rays with a return.

    stamps_ns : (n,) time of each ray
    from_xy : (2,) position of the laser in the robot's frame, metres
    to_xy : (n, 2) end of each ray, in the robot's frame at the ray's time
    scans : number of scans
    frame_id : frame of the laser
    notes : omissions, in words
    """

    stamps_ns: NDArray[np.int64]
    from_xy: Array
    to_xy: Array
    scans: int
    frame_id: str
    notes: tuple[str, ...] = ()

    def __len__(self) -> int:
        return len(self.stamps_ns)


def read_rays(path: Path, topic: str | None, base_frame: str, mount: Mount | None) -> Rays:
    """Read all scans of a topic.

    path : a bag
    topic : topic of laser scans; None takes the only one
    base_frame : the robot's frame, which TF must connect with the laser's
    mount : pose of the laser, to be used instead of TF

    Raises
    ------
    TopicError
        If there are no scans, several topics of them, or TF does not contain the laser's pose.
    """
    scans: list[ScanMessage] = []
    tree = FrameTree()
    with open_reader(path) as reader:
        channels = _choose(list(reader.channels.values()), topic, reader.name)
        for block in reader.blocks():
            tree.take(block, reader.channels.values())
            for channel in channels:
                for row in block.table[block.table["channel"] == channel.id]:
                    data = block.data[row["offset"] : row["offset"] + row["length"]].tobytes()
                    scans.append(read_scan(data, channel.topic, channel.encoding))
        name = reader.name
    if not scans:
        raise RecordingError(f"{name}: {channels[0].topic} holds no scan; name another topic with --scan")
    frame = scans[0].frame_id
    if mount is None:
        mount = tree.mount(base_frame, frame, name)
    return _rays(scans, mount, frame)


def _choose(channels: list[Channel], topic: str | None, bag: str) -> list[Channel]:
    scans = [c for c in channels if c.msgtype == SCAN]
    found = ", ".join(sorted({c.topic for c in scans})) or "none"
    if topic is not None:
        chosen = [c for c in scans if c.topic.lstrip("/") == topic.lstrip("/")]
        if not chosen:
            raise TopicError(f"{bag}: no sensor_msgs/LaserScan on {topic} (found {found}); name another with --scan")
        return chosen
    if not scans:
        there = ", ".join(sorted({c.topic for c in channels})) or "no topic at all"
        raise TopicError(f"{bag}: no sensor_msgs/LaserScan topic (found {there}); a map needs laser scans")
    if len({c.topic for c in scans}) > 1:
        raise TopicError(f"{bag}: topics of sensor_msgs/LaserScan: {found}; name one with --scan")
    return scans


def _rays(scans: list[ScanMessage], mount: Mount, frame: str) -> Rays:
    stamps, ends = [], []
    lost = total = 0
    for scan in scans:
        number = np.arange(len(scan.ranges_m))
        # comparisons with NaN are false: such rays are dropped, as are those without a return
        good = (scan.ranges_m >= scan.range_min_m) & (scan.ranges_m < scan.range_max_m)
        total += len(number)
        lost += int(np.count_nonzero(~good))
        hit, ranges = number[good], scan.ranges_m[good]
        angle = scan.angle_min + scan.angle_step * hit
        direction = np.column_stack((np.cos(angle), np.sin(angle))) @ mount.plane.T
        ends.append(mount.position_xy + ranges[:, None] * direction)
        stamps.append(scan.stamp_ns + np.rint(hit * scan.time_step_s * 1e9).astype(np.int64))
    every, xy = np.concatenate(stamps), np.concatenate(ends)
    usable = np.isfinite(xy).all(axis=1)
    notes = (f"{lost} of {total} rays have no return within the laser's range",) if lost else ()
    return Rays(every[usable], mount.position_xy, xy[usable], len(scans), frame, notes)

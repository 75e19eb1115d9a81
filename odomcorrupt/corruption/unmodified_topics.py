"""Unmodified topics from which a filter can still read the true motion, by type and by frame."""

from __future__ import annotations

import re
import struct
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.odometry_source import ENCODINGS, plain, says_truth, tree_of
from odomcorrupt.sensors.consistent import SENSORS

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from odomcorrupt.bags.block import Block, Channel

MOTION_TYPES = frozenset({
    "DynamicJointState", "EstimatorStates", "GPSFix", "Imu", "JointState", "LinkStates", "MagneticField", "ModelStates",
    "NavSatFix", "Odometry", "ParticleCloud", "Path", "PointStamped", "Pose", "Pose2D", "PoseArray", "PoseStamped",
    "PoseWithCovariance", "PoseWithCovarianceStamped", "SensorCombined", "SensorGps", "SensorState", "TransformStamped",
    "TwistStamped", "TwistWithCovariance", "TwistWithCovarianceStamped", "VehicleAcceleration",
    "VehicleAngularVelocity", "VehicleAttitude", "VehicleGlobalPosition", "VehicleImu", "VehicleLocalPosition",
    "VehicleOdometry",
})  # fmt: skip
"""Messages that carry motion or poses, of whatever package: last part of the type."""

_WHEELS = re.compile(r"wheel_?(tick|vel|speed|state|stat|odom|enc|rpm|angle|pos|count)|ticks?\b|encoder", re.IGNORECASE)
"""Types, or topics of plain numbers, that carry the motion of wheels."""

_COMMANDS = re.compile(r"cmd|command|target|setpoint|desired|reference")

SETPOINT_TOPICS = frozenset({"clicked_point", "cmd_vel", "goal", "goal_pose", "initialpose"})
"""Topics that say where a robot should be, not where it is: last part of the name."""

FRAMED_TYPES = {
    "sensor_msgs/msg/PointCloud2": 0,
    "nav_msgs/msg/GridCells": 0,
    "nav_msgs/msg/OccupancyGrid": 0,
    "map_msgs/msg/OccupancyGridUpdate": 0,
    "nav2_msgs/msg/Costmap": 0,
    "nav2_msgs/msg/VoxelGrid": 0,
    "geometry_msgs/msg/PolygonStamped": 0,
    "visualization_msgs/msg/Marker": 0,
    "visualization_msgs/msg/MarkerArray": 4,
}
"""Message types that contain the true motion if given in the odom frame, and the byte of their (first) header."""


LARGE_TYPES = frozenset({"sensor_msgs/msg/PointCloud2", "nav2_msgs/msg/VoxelGrid"})
"""Messages that are not read for their frame's sake alone."""


def may_be_placed(channel: Channel) -> bool:
    """Return whether the frame of a channel's messages is needed, although the channel itself is not moved."""
    return channel.msgtype in FRAMED_TYPES and channel.msgtype not in LARGE_TYPES


def can_be_consistent(channel: Channel) -> bool:
    """Return whether a channel's numbers can be rewritten to the noisy motion: of a known type, and no command."""
    name = channel.topic.lower()
    known = channel.msgtype in SENSORS and channel.encoding in ENCODINGS and not says_truth(name)
    if not known or _COMMANDS.search(name) or name.rsplit("/", 1)[-1] in SETPOINT_TOPICS:
        return False
    return not channel.msgtype.startswith("std_msgs") or _of_wheels(channel)


def topics_with_true_motion(
    channels: Iterable[Channel], moved: Iterable[str], frames: Mapping[int, str], odom_frame: str
) -> list[str]:
    """Return the unmodified topics with messages that contain the true motion, without those of other robots.

    moved : topics that are moved
    frames : by channel id, those of `frame_of`
    """
    channels, moved = tuple(channels), set(moved)
    trees = {tree_of(topic, channels) for topic in moved}
    return sorted({
        c.topic
        for c in channels
        if c.topic not in moved
        and (not trees or tree_of(c.topic, channels) in trees)
        and c.topic.rsplit("/", 1)[-1] not in SETPOINT_TOPICS
        and (
            c.msgtype.rsplit("/", 1)[-1] in MOTION_TYPES
            or _of_wheels(c)
            or frames.get(c.id) == plain(odom_frame)
            or _is_costmap(c)
        )
    })  # fmt: skip


def _of_wheels(channel: Channel) -> bool:
    """Return whether a channel carries what wheels did, by its type, or the name of a topic of plain numbers."""
    package, _, kind = channel.msgtype.rpartition("/")
    said = channel.topic if package.startswith("std_msgs") else kind
    return bool(_WHEELS.search(said)) and not _COMMANDS.search(channel.topic.lower())


def _is_costmap(channel: Channel) -> bool:
    """Return whether a channel is a costmap, which is centred on the robot even in the map frame."""
    return channel.msgtype in FRAMED_TYPES and "costmap" in channel.topic


def frame_of(block: Block, channel: Channel) -> str | None:
    """Return the frame of a channel's first message in a block, without leading slashes.

    None where its type has none, or the message is too short.
    """
    offset = FRAMED_TYPES.get(channel.msgtype)
    rows = np.flatnonzero(block.table["channel"] == channel.id)
    if offset is None or channel.encoding not in ENCODINGS or not len(rows):
        return None
    row = block.table[rows[0]]
    data = block.data[int(row["offset"]) : int(row["offset"]) + min(int(row["length"]), 1 << 12)].tobytes()
    # offset: the header's stamp, its sequence number in ROS 1, the four CDR bytes in ROS 2
    start = offset + 12
    order = "<" if channel.encoding == "ros1" or data[1:2] == b"\1" else ">"
    if len(data) < start + 4:
        return None
    (length,) = struct.unpack_from(f"{order}I", data, start)
    return plain(data[start + 4 : start + 4 + length].rstrip(b"\0").decode(errors="replace"))

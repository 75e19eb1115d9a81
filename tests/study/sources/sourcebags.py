"""Bags by independent writers, with any message type of odometry and truth."""

from typing import NamedTuple

import numpy as np
import sourcedrive
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from sourcedrive import odometry

from odomcorrupt.study.io import Source, read_runs

STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
STORES[1].register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
SHORT = {
    "Odometry": "nav_msgs/msg/Odometry",
    "PoseStamped": "geometry_msgs/msg/PoseStamped",
    "PoseWithCovarianceStamped": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "TransformStamped": "geometry_msgs/msg/TransformStamped",
    "PointStamped": "geometry_msgs/msg/PointStamped",
    "NavSatFix": "sensor_msgs/msg/NavSatFix",
    "TFMessage": "tf2_msgs/msg/TFMessage",
}


class Sent(NamedTuple):
    """A message before it is written; `value` makes it in either version of ROS."""

    log_ns: int
    topic: str
    kind: str
    value: object


def topic(name, kind, rows, *, frame="odom", child="base_link", variance=1e-3, log_ns=None, stamps=True, status=0):
    """The messages of a topic; NavSatFix takes latitude, longitude, height for positions."""
    variances = np.broadcast_to(variance, len(rows))
    grades = np.broadcast_to(status, len(rows))
    logs = rows.stamps_ns if log_ns is None else log_ns
    poses = zip(rows.xyz.tolist(), rows.quat.tolist(), variances.tolist(), grades.tolist(), strict=True)
    return [
        Sent(int(log), name, kind, (kind, stamp if stamps else 0, frame, child, *pose))
        for log, stamp, pose in zip(logs, rows.stamps_ns.tolist(), poses, strict=True)
    ]


def edges(rows, parent, child, *, name="/tf", log_ns=None):
    """The messages of an edge of TF, one in each."""
    return topic(name, "TFMessage", rows, frame=parent, child=child, variance=0.0, log_ns=log_ns)


def write(path, *sent):
    """Write a bag of the kind that its name says: .mcap, .bag, or a rosbag2 directory."""
    messages = sorted((message for group in sent for message in group), key=lambda message: message.log_ns)
    {".mcap": _mcap, ".bag": _ros1}.get(path.suffix, _ros2)(path, messages)
    return path


def both(path, moved=None, real=None, *, name="/odom", truth="/truth", kind="PoseStamped", odom=None, seen=None):
    """Write a bag of odometry and truth, by default those of `sourcedrive`; odom, seen : options of their topics."""
    first = topic(name, "Odometry", odometry() if moved is None else moved, **(odom or {}))
    return write(path, first, topic(truth, kind, sourcedrive.truth() if real is None else real, **(seen or {})))


def read(folder, moved=None, real=None, *, asked=None, **options):
    """Return the recordings of a bag of odometry and truth; asked : options of `Source`, the others of `both`."""
    return read_runs(Source(both(folder / "run.mcap", moved, real, **options), **(asked or {})))


def _mcap(path, messages):
    with path.open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="ros2")
        channels = {}
        for message in messages:
            if message.topic not in channels:
                text, _ = STORES[2].generate_msgdef(SHORT[message.kind], ros_version=2)
                schema = writer.register_schema(SHORT[message.kind], "ros2msg", text.encode())
                channels[message.topic] = writer.register_channel(message.topic, "cdr", schema)
            data = bytes(STORES[2].serialize_cdr(make(2, *message.value), SHORT[message.kind]))
            writer.add_message(channels[message.topic], message.log_ns, data, message.log_ns)
        writer.finish()


def _ros1(path, messages):
    with Ros1Writer(path) as writer:
        _rosbags(writer, 1, "serialize_ros1", messages)


def _ros2(path, messages):
    with Ros2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        _rosbags(writer, 2, "serialize_cdr", messages)


def _rosbags(writer, ros, serialise, messages):
    connections = {}
    for message in messages:
        kind = SHORT[message.kind]
        if message.topic not in connections:
            connections[message.topic] = writer.add_connection(message.topic, kind, typestore=STORES[ros])
        data = getattr(STORES[ros], serialise)(make(ros, *message.value), kind)
        writer.write(connections[message.topic], message.log_ns, data)


def make(ros, kind, stamp_ns, frame, child, xyz, quat, variance, grade=0):
    """Make a message object."""
    store = STORES[ros]

    def new(name, *fields):
        return store.types[name](*fields)

    stamp = new("builtin_interfaces/msg/Time", *divmod(stamp_ns, 10**9))
    header = new("std_msgs/msg/Header", *((0,) if ros == 1 else ()), stamp, frame)
    point = new("geometry_msgs/msg/Point", *xyz)
    rotation = new("geometry_msgs/msg/Quaternion", *quat)
    pose = new("geometry_msgs/msg/Pose", point, rotation)
    covariance = np.zeros(36)
    covariance[[0, 7, 35]] = variance / 2, variance / 2, variance
    claimed = new("geometry_msgs/msg/PoseWithCovariance", pose, covariance)
    if kind == "Odometry":
        still = new("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        twist = new(
            "geometry_msgs/msg/TwistWithCovariance", new("geometry_msgs/msg/Twist", still, still), 0.0 * covariance
        )
        return new(SHORT[kind], header, child, claimed, twist)
    if kind == "PoseWithCovarianceStamped":
        return new(SHORT[kind], header, claimed)
    if kind == "PoseStamped":
        return new(SHORT[kind], header, pose)
    if kind == "PointStamped":
        return new(SHORT[kind], header, point)
    if kind == "NavSatFix":
        status = new("sensor_msgs/msg/NavSatStatus", grade, 1)
        return new(SHORT[kind], header, status, *xyz, 0.5 * variance * np.eye(3).ravel(), 0)
    shift = new("geometry_msgs/msg/Vector3", *xyz)
    transform = new("geometry_msgs/msg/Transform", shift, rotation)
    stamped = new("geometry_msgs/msg/TransformStamped", header, child, transform)
    return stamped if kind == "TransformStamped" else new(SHORT[kind], [stamped])

"""Messages of either generation of ROS, and bags of them, by the libraries rosbags and mcap."""

import numpy as np
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STORES = {1: get_typestore(Stores.ROS1_NOETIC), 2: get_typestore(Stores.ROS2_HUMBLE)}
STORES[1].register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
NOTHING = np.zeros(36)


def new(ros, kind, *fields):
    """Return a message or a part of one, of a type such as geometry_msgs/Pose."""
    return STORES[ros].types[kind.replace("/", "/msg/")](*fields)


def header(ros, stamp_ns, frame):
    stamp = new(ros, "builtin_interfaces/Time", *divmod(int(stamp_ns), 10**9))
    return new(ros, "std_msgs/Header", *((0,) if ros == 1 else ()), stamp, frame)


def floats(ros, kind, values):
    """Return a Point, a Vector3 or a Quaternion."""
    return new(ros, f"geometry_msgs/{kind}", *map(float, values))


def pose(ros, xyz, quat):
    return new(ros, "geometry_msgs/Pose", floats(ros, "Point", xyz), floats(ros, "Quaternion", quat))


def twist(ros, values):
    return new(ros, "geometry_msgs/Twist", *(floats(ros, "Vector3", part) for part in (values[:3], values[3:])))


def odometry(
    ros, stamp_ns, xyz, quat, *, frames=("odom", "base_link"), speeds=(0.0,) * 6, covariances=(NOTHING, NOTHING)
):
    place = new(ros, "geometry_msgs/PoseWithCovariance", pose(ros, xyz, quat), covariances[0])
    moves = new(ros, "geometry_msgs/TwistWithCovariance", twist(ros, speeds), covariances[1])
    return new(ros, "nav_msgs/Odometry", header(ros, stamp_ns, frames[0]), frames[1], place, moves)


def edge(ros, stamp_ns, parent, child, xyz, quat):
    transform = new(ros, "geometry_msgs/Transform", floats(ros, "Vector3", xyz), floats(ros, "Quaternion", quat))
    return new(ros, "geometry_msgs/TransformStamped", header(ros, stamp_ns, parent), child, transform)


def tree(ros, *edges):
    return new(ros, "tf2_msgs/TFMessage", list(edges))


def serialised(ros, message, *, little=True):
    if ros == 1:
        return bytes(STORES[1].serialize_ros1(message, message.__msgtype__))
    return bytes(STORES[2].serialize_cdr(message, message.__msgtype__, little_endian=little))


def write(path, rows, *, writer=None, little=True):
    """Write messages (log time in ns, topic, message) in their order to .mcap, .bag or a ROS 2 directory; return it.

    writer : of the rosbags library, made with options of its own
    """
    if writer is None and path.suffix == ".mcap":
        return _write_mcap(path, rows)
    if writer is None and path.suffix == ".bag":
        writer = Ros1Writer(path)
    elif writer is None:
        writer = Ros2Writer(path, version=9, storage_plugin=StoragePlugin.SQLITE3)
    ros, made = 1 if isinstance(writer, Ros1Writer) else 2, {}
    with writer:
        for log_ns, topic, message in rows:
            if topic not in made:
                made[topic] = writer.add_connection(topic, message.__msgtype__, typestore=STORES[ros])
            writer.write(made[topic], int(log_ns), serialised(ros, message, little=little))
    return path


def _write_mcap(path, rows):
    with path.open("wb") as stream:
        writer, made = McapWriter(stream), {}
        writer.start(profile="ros2")
        for log_ns, topic, message in rows:
            if topic not in made:
                text, _ = STORES[2].generate_msgdef(message.__msgtype__, ros_version=2)
                schema = writer.register_schema(message.__msgtype__, "ros2msg", text.encode())
                made[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(made[topic], int(log_ns), serialised(2, message), int(log_ns))
        writer.finish()
    return path

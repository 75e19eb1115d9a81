"""Bags with what a robot without motion capture has: odometry, gyro, wheel angles, laser scans and where these sit."""

import numpy as np
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
START_NS = 1_700_000_000_000_000_000


def new(kind, *fields):
    package, _, name = kind.partition("/")
    return STORE.types[f"{package}/msg/{name}"](*fields)


def header(stamp_ns, frame):
    return new("std_msgs/Header", new("builtin_interfaces/Time", *divmod(int(stamp_ns), 10**9)), frame)


def vector(*xyz):
    return new("geometry_msgs/Vector3", *map(float, xyz))


def turned(yaw, roll=0.0):
    """A quaternion of a yaw, after a roll about x."""
    c, s, cr, sr = np.cos(yaw / 2), np.sin(yaw / 2), np.cos(roll / 2), np.sin(roll / 2)
    return new("geometry_msgs/Quaternion", float(c * sr), float(s * sr), float(s * cr), float(c * cr))


def odometry(stamps_ns, xyt, topic="/odom"):
    nothing = np.zeros(36)
    still = new(
        "geometry_msgs/TwistWithCovariance", new("geometry_msgs/Twist", vector(0, 0, 0), vector(0, 0, 0)), nothing
    )
    for stamp, (x, y, yaw) in zip(stamps_ns, xyt, strict=True):
        pose = new("geometry_msgs/Pose", new("geometry_msgs/Point", float(x), float(y), 0.0), turned(yaw))
        claimed = new("geometry_msgs/PoseWithCovariance", pose, nothing)
        yield (
            int(stamp),
            topic,
            "nav_msgs/Odometry",
            new("nav_msgs/Odometry", header(stamp, "odom"), "base_link", claimed, still),
        )


def imu(stamps_ns, rates, topic="/imu/data"):
    nine = np.zeros(9)
    for stamp, rate in zip(stamps_ns, rates, strict=True):
        message = new(
            "sensor_msgs/Imu", header(stamp, "imu"), turned(0.0), nine, vector(*rate), nine, vector(0, 0, 9.8), nine
        )
        yield int(stamp), topic, "sensor_msgs/Imu", message


def joints(stamps_ns, names, angles, topic="/joint_states"):
    none = np.zeros(0)
    for stamp, row in zip(stamps_ns, angles, strict=True):
        message = new("sensor_msgs/JointState", header(stamp, ""), list(names), np.array(row, float), none, none)
        yield int(stamp), topic, "sensor_msgs/JointState", message


def scans(stamps_ns, ranges, topic="/scan", *, turn_s=0.0, view=2 * np.pi, most=8.0, frame="laser", increment=True):
    """Scans of (n, beams) ranges from -view/2 on; turn_s: the time between the first beam and the next sweep's.

    increment : whether time_increment says so, or scan_time alone
    """
    beams = len(ranges[0])
    step = view / beams
    for stamp, row in zip(stamps_ns, ranges, strict=True):
        message = new(
            "sensor_msgs/LaserScan", header(stamp, frame), -view / 2, view / 2 - step, step,
            turn_s / beams * increment, turn_s, 0.05, float(most), np.asarray(row, np.float32), np.zeros(0, np.float32),
        )  # fmt: skip
        yield int(stamp), topic, "sensor_msgs/LaserScan", message


def clouds(stamps_ns, points, topic="/points", frame="laser"):
    """Clouds of points (n, 3) each."""
    fields = [new("sensor_msgs/PointField", name, 4 * i, 7, 1) for i, name in enumerate("xyz")]
    for stamp, xyz in zip(stamps_ns, points, strict=True):
        data = np.ascontiguousarray(xyz, np.float32).view(np.uint8).ravel()
        message = new(
            "sensor_msgs/PointCloud2", header(stamp, frame), 1, len(xyz), fields, False, 12, 12 * len(xyz), data, True
        )  # fmt: skip
        yield int(stamp), topic, "sensor_msgs/PointCloud2", message


def sits(frame="laser", x=0.0, y=0.0, yaw=0.0, roll=0.0, at_ns=START_NS):
    """The TF that says where a sensor sits."""
    transform = new("geometry_msgs/Transform", vector(x, y, 0.2), turned(yaw, roll))
    one = new("geometry_msgs/TransformStamped", header(at_ns, "base_link"), frame, transform)
    yield int(at_ns), "/tf_static", "tf2_msgs/TFMessage", new("tf2_msgs/TFMessage", [one])


def write(path, *groups, late_ns=None):
    """Write the messages of groups to an MCAP file; late_ns(topic): how long after its stamp each is recorded."""
    messages = sorted((m for group in groups for m in group), key=lambda m: m[0])
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        channels = {}
        for stamp, topic, kind, value in messages:
            full = kind.replace("/", "/msg/")
            if topic not in channels:
                text, _ = STORE.generate_msgdef(full, ros_version=2)
                schema = writer.register_schema(full, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            log = stamp + (0 if late_ns is None else late_ns(topic))
            writer.add_message(channels[topic], log, bytes(STORE.serialize_cdr(value, full)), log)
        writer.finish()
    return path

"""Bags with what a robot without motion capture has: odometry, gyro, wheel angles, laser scans and where these sit."""

import numpy as np

import rosmessages

START_NS = 1_700_000_000_000_000_000


def new(kind, *fields):
    return rosmessages.new(2, kind, *fields)


def header(stamp_ns, frame):
    return rosmessages.header(2, stamp_ns, frame)


def vector(*xyz):
    return rosmessages.floats(2, "Vector3", xyz)


def turned(yaw, roll=0.0):
    """The quaternion xyzw of a yaw, after a roll about x."""
    c, s, cr, sr = np.cos(yaw / 2), np.sin(yaw / 2), np.cos(roll / 2), np.sin(roll / 2)
    return c * sr, s * sr, s * cr, c * cr


def odometry(stamps_ns, xyt, topic="/odom"):
    for stamp, (x, y, yaw) in zip(stamps_ns, xyt, strict=True):
        yield int(stamp), topic, rosmessages.odometry(2, stamp, (x, y, 0.0), turned(yaw))


def imu(stamps_ns, rates, topic="/imu/data"):
    nine, level = np.zeros(9), rosmessages.floats(2, "Quaternion", turned(0.0))
    for stamp, rate in zip(stamps_ns, rates, strict=True):
        values = level, nine, vector(*rate), nine, vector(0, 0, 9.8), nine
        message = new("sensor_msgs/Imu", header(stamp, "imu"), *values)
        yield int(stamp), topic, message


def joints(stamps_ns, names, angles, topic="/joint_states"):
    none = np.zeros(0)
    for stamp, row in zip(stamps_ns, angles, strict=True):
        message = new("sensor_msgs/JointState", header(stamp, ""), list(names), np.array(row, float), none, none)
        yield int(stamp), topic, message


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
        yield int(stamp), topic, message


def clouds(stamps_ns, points, topic="/points", frame="laser"):
    """Clouds of points (n, 3) each."""
    fields = [new("sensor_msgs/PointField", name, 4 * i, 7, 1) for i, name in enumerate("xyz")]
    for stamp, xyz in zip(stamps_ns, points, strict=True):
        data = np.ascontiguousarray(xyz, np.float32).view(np.uint8).ravel()
        message = new(
            "sensor_msgs/PointCloud2", header(stamp, frame), 1, len(xyz), fields, False, 12, 12 * len(xyz), data, True
        )  # fmt: skip
        yield int(stamp), topic, message


def sits(frame="laser", x=0.0, y=0.0, yaw=0.0, roll=0.0, at_ns=START_NS):
    """The TF that says where a sensor sits."""
    edge = rosmessages.edge(2, at_ns, "base_link", frame, (x, y, 0.2), turned(yaw, roll))
    yield int(at_ns), "/tf_static", rosmessages.tree(2, edge)


def write(path, *groups, late_ns=None):
    """Write the messages of groups to an MCAP file; late_ns(topic): how long after its stamp each is recorded."""
    messages = sorted((m for group in groups for m in group), key=lambda m: m[0])
    rows = ((stamp + (late_ns(topic) if late_ns else 0), topic, message) for stamp, topic, message in messages)
    return rosmessages.write(path, rows)

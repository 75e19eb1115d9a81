"""The messages of a robot with a camera, made fast: one template a topic, in which stamps and numbers are replaced.

Images 30 Hz, scan 10 Hz, IMU 200 Hz, Odometry 50 Hz and TF 50 Hz, as `bags.py` and `pipe.py` need them.
"""

from __future__ import annotations

import heapq
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

if TYPE_CHECKING:
    from collections.abc import Iterator

START_NS = 1_700_000_000 * 10**9
IMAGE_BYTES = 130_000
RADIUS_M, SPEED = 5.0, 0.5

TOPICS = {
    "/camera": ("sensor_msgs/msg/CompressedImage", 30),
    "/scan": ("sensor_msgs/msg/LaserScan", 10),
    "/imu": ("sensor_msgs/msg/Imu", 200),
    "/odom": ("nav_msgs/msg/Odometry", 50),
    "/tf": ("tf2_msgs/msg/TFMessage", 50),
}
ODOM_ONLY = ("/odom", "/tf")

# Numbers that stand in the templates where others will: seconds, nanoseconds, and x, y, z, qx, qy, qz, qw.
_SEC, _NSEC = 0x1234567, 0x7654321
_POSE = (1.25e-7, 2.25e-7, 3.25e-7, 4.25e-7, 5.25e-7, 6.25e-7, 7.25e-7)


class Made(NamedTuple):
    """A message as a bag has it."""

    log_ns: int
    topic: str
    data: bytes


@dataclass(frozen=True)
class Template:
    """Bytes of a message, where its stamp is, and where its pose is (-1: nowhere)."""

    data: bytes
    stamp_at: int
    pose_at: int

    def at(self, stamp_ns: int) -> bytes:
        """Return the message of a time: on a circle, at constant speed."""
        out = bytearray(self.data)
        struct.pack_into("<II", out, self.stamp_at, *divmod(stamp_ns, 10**9))
        if self.pose_at >= 0:
            angle = (stamp_ns - START_NS) * 1e-9 * SPEED / RADIUS_M
            turn = np.sin(angle / 2.0), np.cos(angle / 2.0)
            x, y = RADIUS_M * np.sin(angle), RADIUS_M * (1.0 - np.cos(angle))
            struct.pack_into("<7d", out, self.pose_at, x, y, 0.0, 0.0, 0.0, *turn)
        return bytes(out)


def typestore(ros: int) -> Any:
    """Return the types of a ROS generation, TFMessage among them."""
    store = get_typestore(Stores.ROS1_NOETIC if ros == 1 else Stores.ROS2_HUMBLE)
    if ros == 1:
        transforms = "geometry_msgs/TransformStamped[] transforms"
        store.register(get_types_from_msg(transforms, "tf2_msgs/msg/TFMessage"))
    return store


def templates(ros: int) -> dict[str, list[Template]]:
    """Return templates by topic; the camera has several, so that no codec sees the same image twice in a chunk."""
    store = typestore(ros)

    def make(name: str, *values: Any) -> Any:
        return store.types[name](*values)

    def header(frame: str) -> Any:
        stamp = make("builtin_interfaces/msg/Time", _SEC, _NSEC)
        return make("std_msgs/msg/Header", *([1] if ros == 1 else []), stamp, frame)

    point = make("geometry_msgs/msg/Point", *_POSE[:3])
    turn = make("geometry_msgs/msg/Quaternion", *_POSE[3:])
    vector = make("geometry_msgs/msg/Vector3", *_POSE[:3])
    zero = make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
    ahead = make("geometry_msgs/msg/Vector3", SPEED, 0.0, 0.0)
    turning = make("geometry_msgs/msg/Vector3", 0.0, 0.0, SPEED / RADIUS_M)
    wide = np.diag([0.01] * 6).ravel()
    pose = make("geometry_msgs/msg/PoseWithCovariance", make("geometry_msgs/msg/Pose", point, turn), wide)
    twist = make("geometry_msgs/msg/TwistWithCovariance", make("geometry_msgs/msg/Twist", ahead, turning), wide)
    transform = make("geometry_msgs/msg/Transform", vector, turn)
    edge = make("geometry_msgs/msg/TransformStamped", header("odom"), "base_link", transform)
    rng = np.random.default_rng(1)
    # three quarters of a camera's bytes are news to a codec
    images = [rng.integers(0, 256, IMAGE_BYTES, dtype=np.uint8) for _ in range(12)]
    for image in images:
        image[::1000] = 0
        image[: IMAGE_BYTES // 4] = 7
    ranges = rng.uniform(0.5, 10.0, 720).astype(np.float32)
    still = np.zeros(9)
    messages = {
        "/camera": [make("sensor_msgs/msg/CompressedImage", header("camera"), "jpeg", image) for image in images],
        "/scan": [
            make("sensor_msgs/msg/LaserScan", header("laser"), -3.1, 3.1, 0.0086, 0.0, 0.1, 0.1, 12.0, ranges, ranges)
        ],
        "/imu": [make("sensor_msgs/msg/Imu", header("imu"), turn, still, turning, still, zero, still)],
        "/odom": [make("nav_msgs/msg/Odometry", header("odom"), "base_link", pose, twist)],
        "/tf": [make("tf2_msgs/msg/TFMessage", [edge])],
    }
    pack = store.serialize_ros1 if ros == 1 else store.serialize_cdr
    stamp, place = struct.pack("<II", _SEC, _NSEC), struct.pack("<7d", *_POSE)
    out = {}
    for topic, some in messages.items():
        packed = [bytes(pack(message, TOPICS[topic][0])) for message in some]
        out[topic] = [Template(data, data.index(stamp), data.find(place)) for data in packed]
    return out


def made(ros: int, topics: tuple[str, ...], seconds: float | None) -> Iterator[Made]:
    """Yield messages in the order of log times; without an end where `seconds` is None."""
    known = templates(ros)

    def one(topic: str, delay_ns: int) -> Iterator[Made]:
        rate, number = TOPICS[topic][1], 0
        while seconds is None or number < seconds * rate:
            stamp_ns = START_NS + number * 10**9 // rate
            yield Made(stamp_ns + delay_ns, topic, known[topic][number % len(known[topic])].at(stamp_ns))
            number += 1

    return heapq.merge(*(one(topic, 1000 * i) for i, topic in enumerate(topics)))

"""Recordings as MCAP files with ROS 2 messages, independent of the package: mcap writes, rosbags packs one template."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

if TYPE_CHECKING:
    from pathlib import Path

    from ordinary.machine import Odometry
    from ordinary.truths import Messages

__all__ = ["read_odometry", "write_bag"]

START_NS = 1_760_000_000 * 10**9
_SEC, _NSEC = 0x1234567, 0x7654321
_MARKS = tuple(1.25e-7 * (i + 1) for i in range(16))
_STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = {
    "odometry": "nav_msgs/msg/Odometry",
    "pose": "geometry_msgs/msg/PoseStamped",
    "pose_cov": "geometry_msgs/msg/PoseWithCovarianceStamped",
    "tf": "tf2_msgs/msg/TFMessage",
    "fix": "sensor_msgs/msg/NavSatFix",
}


@dataclass(frozen=True)
class _Template:
    """Serialised message, with the byte offsets of its stamp and its numbers."""

    data: bytes
    stamp_at: int
    numbers_at: tuple[int, ...]

    def filled(self, stamp_ns: int, numbers: tuple[float, ...]) -> bytearray:
        out = bytearray(self.data)
        struct.pack_into("<II", out, self.stamp_at, *divmod(stamp_ns, 10**9))
        for at, number in zip(self.numbers_at, numbers, strict=True):
            struct.pack_into("<d", out, at, number)
        return out


@cache
def _template(kind: str, frames: tuple[str, str]) -> _Template:
    def make(name: str, *values: Any) -> Any:
        return _STORE.types[name](*values)

    def vector(name: str, *values: float) -> Any:
        return make(f"geometry_msgs/msg/{name}", *values)

    m = _MARKS
    header = make("std_msgs/msg/Header", make("builtin_interfaces/msg/Time", _SEC, _NSEC), frames[0])
    turn = vector("Quaternion", 0.0, 0.0, m[2], m[3])
    pose = vector("Pose", vector("Point", m[0], m[1], 0.0), turn)
    spread = np.diag([0.05, 0.05, 1e-6, 1e-6, 1e-6, 0.05]).ravel()
    if kind == "odometry":
        twist = vector("Twist", vector("Vector3", m[4], 0.0, 0.0), vector("Vector3", 0.0, 0.0, m[5]))
        message = make(
            TYPES[kind], header, frames[1], make("geometry_msgs/msg/PoseWithCovariance", pose, spread),
            make("geometry_msgs/msg/TwistWithCovariance", twist, spread),
        )  # fmt: skip
        used = m[:6]
    elif kind == "pose":
        message, used = make(TYPES[kind], header, pose), m[:4]
    elif kind == "pose_cov":
        message, used = make(TYPES[kind], header, make("geometry_msgs/msg/PoseWithCovariance", pose, spread)), m[:4]
    elif kind == "tf":
        transform = make("geometry_msgs/msg/Transform", vector("Vector3", m[0], m[1], 0.0), turn)
        stamped = make("geometry_msgs/msg/TransformStamped", header, frames[1], transform)
        message, used = make(TYPES[kind], [stamped]), m[:4]
    else:
        status = make("sensor_msgs/msg/NavSatStatus", 2, 1)
        variances = np.diag([m[3], m[4], m[5]]).ravel()
        message, used = make(TYPES[kind], header, status, m[0], m[1], m[2], variances, 2), m[:6]
    data = bytes(_STORE.serialize_cdr(message, TYPES[kind]))
    return _Template(
        data, data.index(struct.pack("<II", _SEC, _NSEC)), tuple(data.index(struct.pack("<d", n)) for n in used)
    )


def _flat(poses: np.ndarray) -> np.ndarray:
    return np.column_stack((poses[:, 0], poses[:, 1], np.sin(0.5 * poses[:, 2]), np.cos(0.5 * poses[:, 2])))


def _packed(part: Messages) -> list[tuple[int, str, str, bytes]]:
    template = _template(part.kind, part.frames)
    numbers = _flat(part.rows) if part.kind != "fix" else np.column_stack(
        (part.rows, part.variance, part.variance, 4.0 * part.variance)
    )  # fmt: skip
    status_at = template.stamp_at + 8 + 4 + len(part.frames[0]) + 1
    out = []
    for i, row in enumerate(numbers):
        data = template.filled(START_NS + round(part.stamp_s[i] * 1e9), tuple(row))
        if part.kind == "fix":
            struct.pack_into("<b", data, status_at, int(part.status[i]))
        out.append((START_NS + round(part.log_s[i] * 1e9), part.topic, part.kind, bytes(data)))
    return out


def write_bag(path: Path, odometry: Odometry, parts: list[Messages]) -> None:
    """Write /odom and the messages of a truth, in the order of their log times."""
    template = _template("odometry", ("odom", "base_link"))
    numbers = np.column_stack((_flat(odometry.xyt), odometry.twist))
    entries = [
        (START_NS + round((stamp + 0.001) * 1e9), "/odom", "odometry",
         bytes(template.filled(START_NS + round(stamp * 1e9), tuple(row))))
        for stamp, row in zip(odometry.stamp_s, numbers, strict=True)
    ]  # fmt: skip
    for part in parts:
        entries += _packed(part)
    entries.sort(key=lambda entry: entry[0])
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1 << 20, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="ordinary laboratory")
        channels: dict[str, int] = {}
        for log_ns, topic, kind, data in entries:
            if topic not in channels:
                text = _STORE.generate_msgdef(TYPES[kind], ros_version=2)[0]
                schema = writer.register_schema(TYPES[kind], "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], log_ns, data, log_ns)
        writer.finish()


def read_odometry(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """Return stamps (s since the recording's zero) and poses (n, 3) of /odom."""
    stamps, poses = [], []
    template = _template("odometry", ("odom", "base_link"))
    with path.open("rb") as file:
        for _, _, message in make_reader(file).iter_messages(topics=["/odom"]):
            sec, nsec = struct.unpack_from("<II", message.data, template.stamp_at)
            x, y, sin, cos = (struct.unpack_from("<d", message.data, at)[0] for at in template.numbers_at[:4])
            stamps.append((sec * 10**9 + nsec - START_NS) * 1e-9)
            poses.append((x, y, 2.0 * np.arctan2(sin, cos)))
    xyt = np.array(poses).reshape(-1, 3)
    xyt[:, 2] = np.unwrap(xyt[:, 2])
    return np.array(stamps), xyt

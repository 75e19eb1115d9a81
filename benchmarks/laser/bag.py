"""A simulated drive as a bag without truth: Odometry, and TF and LaserScan of a ray-cast laser or Imu of a gyro."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.writer import Writer
from rosbags.typesys import Stores, get_typestore

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from laser.drives import Seen
    from odomcorrupt.simulation.run import SimulatedRun

__all__ = ["write_bag", "write_gyro_bag"]

STORE = get_typestore(Stores.ROS2_HUMBLE)
MOST_M = 8.0


def write_bag(path: Path, seen: Seen, *, sweep_s: float = 0.2, beams: int = 450) -> None:
    """Write the bag that the robot would have recorded."""
    _write(path, [*_odometry(seen.run), *_scans(seen, sweep_s, beams)])


def write_gyro_bag(path: Path, run: SimulatedRun, stamps_ns: NDArray[np.int64], rates: NDArray[np.float64]) -> None:
    """Write the bag of a robot with wheels and a gyro alone: /odom, and rates (n, 3) in rad/s as /imu/data."""
    odometry = [message for message in _odometry(run) if message[1] == "/odom"]
    _write(path, [*odometry, *_imu(stamps_ns, rates)])


def _write(path: Path, messages: list[tuple[int, str, str, Any]]) -> None:
    messages.sort(key=lambda message: message[0])
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2")
        channels: dict[str, int] = {}
        for stamp_ns, topic, kind, value in messages:
            if topic not in channels:
                text, _ = STORE.generate_msgdef(kind, ros_version=2)
                schema = writer.register_schema(kind, "ros2msg", text.encode())
                channels[topic] = writer.register_channel(topic, "cdr", schema)
            writer.add_message(channels[topic], stamp_ns, bytes(STORE.serialize_cdr(value, kind)), stamp_ns)
        writer.finish()


def _new(kind: str, *fields: Any) -> Any:
    package, _, name = kind.partition("/")
    return STORE.types[f"{package}/msg/{name}"](*fields)


def _header(stamp_ns: int, frame: str) -> Any:
    return _new("std_msgs/Header", _new("builtin_interfaces/Time", *divmod(stamp_ns, 10**9)), frame)


def _vector(*xyz: float) -> Any:
    return _new("geometry_msgs/Vector3", *map(float, xyz))


def _odometry(run: SimulatedRun) -> list[tuple[int, str, str, Any]]:
    nothing = np.zeros(36)
    out = []
    for stamp, (x, y, yaw), (v, w, turn) in zip(run.odom_stamps_ns.tolist(), run.odom_xyt, run.odom_twist, strict=True):
        rotation = _new("geometry_msgs/Quaternion", 0.0, 0.0, float(np.sin(yaw / 2.0)), float(np.cos(yaw / 2.0)))
        point = _new("geometry_msgs/Point", float(x), float(y), 0.0)
        pose = _new("geometry_msgs/PoseWithCovariance", _new("geometry_msgs/Pose", point, rotation), nothing)
        speeds = _new("geometry_msgs/Twist", _vector(v, w, 0.0), _vector(0.0, 0.0, turn))
        twist = _new("geometry_msgs/TwistWithCovariance", speeds, nothing)
        header = _header(stamp, "odom")
        out.append(
            (stamp, "/odom", "nav_msgs/msg/Odometry", _new("nav_msgs/Odometry", header, "base_link", pose, twist))
        )
        moved = _new("geometry_msgs/Transform", _vector(x, y, 0.0), rotation)
        edge = _new("geometry_msgs/TransformStamped", header, "base_link", moved)
        out.append((stamp, "/tf", "tf2_msgs/msg/TFMessage", _new("tf2_msgs/TFMessage", [edge])))
    return out


def _imu(stamps_ns: NDArray[np.int64], rates: NDArray[np.float64]) -> list[tuple[int, str, str, Any]]:
    nothing = np.zeros(9)
    level = _new("geometry_msgs/Quaternion", 0.0, 0.0, 0.0, 1.0)
    out = []
    for stamp, rate in zip(stamps_ns.tolist(), rates, strict=True):
        message = _new(
            "sensor_msgs/Imu", _header(stamp, "imu"), level, nothing, _vector(*rate), nothing, _vector(0.0, 0.0, 9.81),
            nothing,
        )  # fmt: skip
        out.append((stamp, "/imu/data", "sensor_msgs/msg/Imu", message))
    return out


def _scans(seen: Seen, sweep_s: float, beams: int) -> list[tuple[int, str, str, Any]]:
    step = 2.0 * np.pi / beams
    out = []
    for sweep in seen.sweeps.sweeps:
        ranges: NDArray[np.float32] = np.full(beams, np.inf, dtype=np.float32)
        beam = np.round(sweep.after_s / sweep_s * beams).astype(np.int64)
        ranges[beam] = np.hypot(*sweep.xy.T)
        message = _new(
            "sensor_msgs/LaserScan", _header(sweep.stamp_ns, "laser"), -np.pi, np.pi - step, step, sweep_s / beams,
            sweep_s, 0.05, MOST_M, ranges, np.zeros(0, dtype=np.float32),
        )  # fmt: skip
        out.append((sweep.stamp_ns, "/scan", "sensor_msgs/msg/LaserScan", message))
    return out

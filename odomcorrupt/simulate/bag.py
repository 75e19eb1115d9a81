"""Recordings as ROS 2 MCAP files."""

from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from odomcorrupt.simulate.run import SimulatedRun

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = {
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/ground_truth": "geometry_msgs/msg/PoseStamped",
}


class _Entry(NamedTuple):
    stamp_ns: int
    topic: str
    message: object


def write_mcap(
    run: SimulatedRun,
    path: str | Path,
    *,
    odom_topic: str = "/odom",
    truth_topic: str = "/ground_truth",
    tf: bool = True,
) -> None:
    """Write a run as one MCAP file with zstd chunks, in order of the stamps (which are also the log times).

    Parameters
    ----------
    run : SimulatedRun
        The recording; its answer is not written.
    path : str or Path
        The file to make.
    odom_topic, truth_topic : str
        Topics of the Odometry (odom to base_link) and of the PoseStamped (in world).
    tf : bool
        Whether /tf repeats the odometry as odom to base_link.
    """
    entries = [*_odometry(run, odom_topic, tf=tf), *_truth(run, truth_topic)]
    entries.sort(key=lambda entry: entry.stamp_ns)
    with Path(path).open("wb") as file:
        writer = Writer(file, compression=CompressionType.ZSTD)
        writer.start(profile="ros2", library="wheelsim")
        channels: dict[str, tuple[int, str]] = {}
        for sequence, (stamp_ns, topic, message) in enumerate(entries):
            if topic not in channels:
                channels[topic] = _channel(writer, topic, message.__msgtype__)
            channel_id, typename = channels[topic]
            data = bytes(STORE.serialize_cdr(message, typename))
            writer.add_message(channel_id, log_time=stamp_ns, publish_time=stamp_ns, sequence=sequence, data=data)
        writer.finish()


def _channel(writer: Writer, topic: str, typename: str) -> tuple[int, str]:
    text, _ = STORE.generate_msgdef(typename, ros_version=2)
    schema_id = writer.register_schema(typename, "ros2msg", text.encode())
    return writer.register_channel(topic, "cdr", schema_id), typename


def _odometry(run: SimulatedRun, topic: str, *, tf: bool) -> Iterator[_Entry]:
    kinds = STORE.types
    pose_covariance = np.diag([1e-3, 1e-3, 1e6, 1e6, 1e6, 1e-2]).ravel()
    twist_covariance = np.diag([1e-4, 1e-4, 1e6, 1e6, 1e6, 1e-3]).ravel()
    for stamp_ns, xyt, (forward, left, turn) in zip(
        run.odom_stamps_ns.tolist(), run.odom_xyt.tolist(), run.odom_twist.tolist(), strict=True
    ):
        header = _header(stamp_ns, "odom")
        pose = _pose(*xyt)
        twist = kinds["geometry_msgs/msg/Twist"](linear=_vector(forward, left), angular=_vector(0.0, 0.0, turn))
        message = kinds[TYPES["/odom"]](
            header=header,
            child_frame_id="base_link",
            pose=kinds["geometry_msgs/msg/PoseWithCovariance"](pose=pose, covariance=pose_covariance),
            twist=kinds["geometry_msgs/msg/TwistWithCovariance"](twist=twist, covariance=twist_covariance),
        )
        yield _Entry(stamp_ns, topic, message)
        if tf:
            link = kinds["geometry_msgs/msg/Transform"](
                translation=_vector(pose.position.x, pose.position.y), rotation=pose.orientation
            )
            stamped = kinds["geometry_msgs/msg/TransformStamped"](
                header=header, child_frame_id="base_link", transform=link
            )
            yield _Entry(stamp_ns, "/tf", kinds[TYPES["/tf"]](transforms=[stamped]))


def _truth(run: SimulatedRun, topic: str) -> Iterator[_Entry]:
    kind = STORE.types[TYPES["/ground_truth"]]
    for stamp_ns, xyt in zip(run.truth_stamps_ns.tolist(), run.truth_xyt.tolist(), strict=True):
        yield _Entry(stamp_ns, topic, kind(header=_header(stamp_ns, "world"), pose=_pose(*xyt)))


def _header(stamp_ns: int, frame_id: str) -> object:
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    stamp = STORE.types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    return STORE.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)


def _vector(x: float, y: float, z: float = 0.0) -> object:
    return STORE.types["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)


def _pose(x: float, y: float, yaw_rad: float) -> object:
    quaternion = STORE.types["geometry_msgs/msg/Quaternion"]
    point = STORE.types["geometry_msgs/msg/Point"](x=x, y=y, z=0.0)
    turned = quaternion(x=0.0, y=0.0, z=float(np.sin(0.5 * yaw_rad)), w=float(np.cos(0.5 * yaw_rad)))
    return STORE.types["geometry_msgs/msg/Pose"](position=point, orientation=turned)

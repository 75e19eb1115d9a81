"""Recordings as ROS 2 MCAP files, with messages serialised as rows of a byte array."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from struct import pack
from typing import Any, BinaryIO

import numpy as np
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from odomcorrupt.simulation.run import SimulatedRun

STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = {
    "/odom": "nav_msgs/msg/Odometry",
    "/tf": "tf2_msgs/msg/TFMessage",
    "/ground_truth": "geometry_msgs/msg/PoseStamped",
}
_MARKS = tuple(1.0 + i * np.pi for i in range(7))
"""Placeholder numbers in a template message."""
_MARK_SEC, _MARK_NANOSEC = 0x5EC05EC, 0x2A205EC


def odometry(run: SimulatedRun) -> np.ndarray:
    """Return the serialised Odometry messages (odom to base_link), one per row."""
    x, y, qz, qw, forward, left, turn = _MARKS
    pose = _new("PoseWithCovariance", pose=_pose(x, y, qz, qw), covariance=_spread(1e-3, 1e-3, 1e-2))
    twist = _new("Twist", linear=_vector(forward, left), angular=_vector(0.0, 0.0, turn))
    stamped = STORE.types[TYPES["/odom"]](
        header=_header("odom"),
        child_frame_id="base_link",
        pose=pose,
        twist=_new("TwistWithCovariance", twist=twist, covariance=_spread(1e-4, 1e-4, 1e-3)),
    )
    numbers = np.column_stack((_planar(run.odom_xyt), run.odom_twist))
    return _fill(stamped, TYPES["/odom"], run.odom_stamps_ns, numbers)


def links(run: SimulatedRun) -> np.ndarray:
    """Return the odometry as serialised TFMessages, one per row."""
    x, y, qz, qw = _MARKS[:4]
    link = _new("Transform", translation=_vector(x, y), rotation=_turned(qz, qw))
    stamped = _new("TransformStamped", header=_header("odom"), child_frame_id="base_link", transform=link)
    message = STORE.types[TYPES["/tf"]](transforms=[stamped])
    return _fill(message, TYPES["/tf"], run.odom_stamps_ns, _planar(run.odom_xyt))


def poses(run: SimulatedRun) -> np.ndarray:
    """Return the truth as serialised PoseStamped messages in world, one per row."""
    message = _new("PoseStamped", header=_header("world"), pose=_pose(*_MARKS[:4]))
    return _fill(message, TYPES["/ground_truth"], run.truth_stamps_ns, _planar(run.truth_xyt))


def _planar(xyt: np.ndarray) -> np.ndarray:
    return np.column_stack((xyt[:, :2], np.sin(0.5 * xyt[:, 2]), np.cos(0.5 * xyt[:, 2])))


def _fill(message: Any, typename: str, stamps_ns: np.ndarray, numbers: np.ndarray) -> np.ndarray:
    """Return serialised messages, one per row: copies of a template with placeholders replaced by stamps and numbers.

    stamps_ns : (n,) stamps of the headers
    numbers : (n, k) values for the first k placeholders
    """
    one = bytes(STORE.serialize_cdr(message, typename))
    rows = np.tile(np.frombuffer(one, dtype=np.uint8), (len(stamps_ns), 1))
    for mark, width, values in _marked(stamps_ns, numbers):
        at = one.index(mark)
        rows[:, at : at + width] = np.ascontiguousarray(values).view(np.uint8).reshape(-1, width)
    return rows


def _marked(stamps_ns: np.ndarray, numbers: np.ndarray) -> Iterator[tuple[bytes, int, np.ndarray]]:
    sec, nanosec = np.divmod(stamps_ns, 1_000_000_000)
    yield pack("<i", _MARK_SEC), 4, sec.astype("<i4")
    yield pack("<I", _MARK_NANOSEC), 4, nanosec.astype("<u4")
    for mark, column in zip(_MARKS, numbers.T, strict=False):
        yield pack("<d", mark), 8, column.astype("<f8")


def _new(kind: str, **fields: Any) -> Any:
    return STORE.types[f"geometry_msgs/msg/{kind}"](**fields)


def _header(frame_id: str) -> Any:
    stamp = STORE.types["builtin_interfaces/msg/Time"](sec=_MARK_SEC, nanosec=_MARK_NANOSEC)
    return STORE.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame_id)


def _vector(x: float, y: float, z: float = 0.0) -> Any:
    return _new("Vector3", x=x, y=y, z=z)


def _turned(qz: float, qw: float) -> Any:
    return _new("Quaternion", x=0.0, y=0.0, z=qz, w=qw)


def _pose(x: float, y: float, qz: float, qw: float) -> Any:
    return _new("Pose", position=_new("Point", x=x, y=y, z=0.0), orientation=_turned(qz, qw))


def _spread(x: float, y: float, yaw: float) -> np.ndarray:
    return np.diag([x, y, 1e6, 1e6, 1e6, yaw]).ravel()


def write_mcap(
    run: SimulatedRun,
    target: str | Path | BinaryIO,
    *,
    odom_topic: str = "/odom",
    truth_topic: str = "/ground_truth",
    tf: bool = True,
    metadata: Mapping[str, str] | None = None,
) -> None:
    """Write a run as one MCAP file with zstd chunks, in order of the stamps (which are also the log times).

    run : the recording; its ground-truth fault is not written
    target : the output file
    odom_topic, truth_topic : topics of the Odometry (odom to base_link) and of the PoseStamped (in world)
    tf : whether /tf repeats the odometry as odom to base_link
    metadata : content of the metadata record ``simulate``
    """
    if isinstance(target, str | Path):
        with Path(target).open("wb") as file:
            return write_mcap(run, file, odom_topic=odom_topic, truth_topic=truth_topic, tf=tf, metadata=metadata)
    topics = [(odom_topic, TYPES["/odom"], run.odom_stamps_ns, odometry(run))]
    if tf:
        topics.append(("/tf", TYPES["/tf"], run.odom_stamps_ns, links(run)))
    topics.append((truth_topic, TYPES["/ground_truth"], run.truth_stamps_ns, poses(run)))
    stamps_ns = np.concatenate([stamps for _, _, stamps, _ in topics])
    sizes = [len(stamps) for _, _, stamps, _ in topics]
    places = np.column_stack((np.repeat(np.arange(len(sizes)), sizes), np.concatenate([np.arange(n) for n in sizes])))
    # at equal stamps: odometry, transform, truth
    order = np.lexsort((places[:, 0], stamps_ns))
    writer: Any = Writer(target, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library="wheelsim")
    if metadata is not None:
        writer.add_metadata("simulate", dict(metadata))
    channels: dict[int, int] = {}
    pairs = zip(stamps_ns[order].tolist(), places[order].tolist(), strict=True)
    for sequence, (stamp_ns, (topic, row)) in enumerate(pairs):
        if topic not in channels:
            channels[topic] = _channel(writer, *topics[topic][:2])
        data = topics[topic][3][row].tobytes()
        writer.add_message(channels[topic], log_time=stamp_ns, publish_time=stamp_ns, sequence=sequence, data=data)
    writer.finish()
    return None


def _channel(writer: Any, topic: str, typename: str) -> int:
    text, _ = STORE.generate_msgdef(typename, ros_version=2)
    schema_id = writer.register_schema(typename, "ros2msg", text.encode())
    return int(writer.register_channel(topic, "cdr", schema_id))

"""Recordings as ROS 2 MCAP files."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from mcap.writer import CompressionType, Writer

from odomcorrupt.simulation.messages import STORE, TYPES, links, odometry, poses
from odomcorrupt.simulation.record import SimulatedRun


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

    Parameters
    ----------
    run : SimulatedRun
        The recording; its answer is not written.
    target : str, Path or binary stream
        The file to make.
    odom_topic, truth_topic : str
        Topics of the Odometry (odom to base_link) and of the PoseStamped (in world).
    tf : bool
        Whether /tf repeats the odometry as odom to base_link.
    metadata : mapping of str, optional
        What to say of the bag in its metadata record ``simulate``.
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
    # of one stamp, odometry comes before its transform, and both before the truth
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

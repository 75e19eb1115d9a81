"""The bags that `bags.py` measures, written with other people's libraries."""

from __future__ import annotations

import shutil
import subprocess
import sys
from typing import TYPE_CHECKING

from bag_messages import ODOM_ONLY, TOPICS, made, typestore
from mcap.writer import CompressionType
from mcap.writer import Writer as McapLibraryWriter
from rosbags.rosbag1 import Writer as Ros1LibraryWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2LibraryWriter

if TYPE_CHECKING:
    from pathlib import Path

CHUNK_BYTES = 1 << 20


def topics_of(kind: str) -> tuple[str, ...]:
    """Return the topics of a bag: of a robot with a camera, or odometry and TF only."""
    return ODOM_ONLY if kind == "odom" else tuple(TOPICS)


def write_mcap(path: Path, kind: str, codec: str, seconds: float) -> None:
    """Write an MCAP with chunks of 1 MB."""
    store = typestore(2)
    with path.open("wb") as stream:
        writer = McapLibraryWriter(stream, chunk_size=CHUNK_BYTES, compression=CompressionType[codec.upper()])
        writer.start(profile="ros2", library="benchmark")
        channels = {}
        for topic in topics_of(kind):
            msgtype = TOPICS[topic][0]
            text = store.generate_msgdef(msgtype, ros_version=2)[0]
            channels[topic] = writer.register_channel(
                topic, "cdr", writer.register_schema(msgtype, "ros2msg", text.encode())
            )
        for log_ns, topic, data in made(2, topics_of(kind), seconds):
            writer.add_message(channels[topic], log_ns, data, log_ns)
        writer.finish()


def write_ros1(path: Path, kind: str, codec: str, seconds: float) -> None:
    """Write a ROS 1 bag."""
    plain = path.with_name(f"plain_{path.name}")
    store = typestore(1)
    with Ros1LibraryWriter(plain) as writer:
        connections = {t: writer.add_connection(t, TOPICS[t][0], typestore=store) for t in topics_of(kind)}
        for log_ns, topic, data in made(1, topics_of(kind), seconds):
            writer.write(connections[topic], log_ns, data)
    # the library's own LZ4 chunks are none that ROS 1 can read
    zero = ["--alpha", "0", "0", "0", "0", "--compression", codec]
    subprocess.run([sys.executable, "-m", "odomcorrupt", plain, path, *zero], check=True, stderr=subprocess.DEVNULL)
    plain.unlink()


def write_sqlite3(path: Path, kind: str, _codec: str, seconds: float) -> None:
    """Write a ROS 2 directory with a sqlite3 file."""
    shutil.rmtree(path, ignore_errors=True)
    store = typestore(2)
    with Ros2LibraryWriter(path, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {t: writer.add_connection(t, TOPICS[t][0], typestore=store) for t in topics_of(kind)}
        for log_ns, topic, data in made(2, topics_of(kind), seconds):
            writer.write(connections[topic], log_ns, data)


WRITERS = {"mcap": write_mcap, "ros1": write_ros1, "sqlite3": write_sqlite3}

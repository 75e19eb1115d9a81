"""Speed commands as an MCAP of geometry_msgs/Twist, for playback to a robot's base."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

START_NS = 1_000_000_000
"""Log time of the first command: 0 would be taken for no time at all."""
_TYPE = "geometry_msgs/msg/Twist"
_CDR = b"\x00\x01\x00\x00"


def write_twists(
    target: BinaryIO, times_s: NDArray[np.float64], twist: NDArray[np.float64], topic: str = "/cmd_vel"
) -> None:
    """Write an MCAP with one Twist message for each command.

    target : a binary stream
    times_s : (n,) times since the first command, seconds; used as log times
    twist : (n, 3) forward and leftward speed, m/s, and turn rate, rad/s
    topic : of the commands
    """
    from mcap.writer import CompressionType, Writer  # noqa: PLC0415 - only needed to plan a drive
    from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 - as above

    text, _ = get_typestore(Stores.ROS2_HUMBLE).generate_msgdef(_TYPE, ros_version=2)
    rows = np.zeros((len(times_s), 6), dtype="<f8")
    rows[:, [0, 1, 5]] = twist
    stamps_ns = START_NS + np.rint(times_s * 1e9).astype(np.int64)
    writer: Any = Writer(target, compression=CompressionType.ZSTD)
    writer.start(profile="ros2", library="odomcorrupt")
    schema = writer.register_schema(_TYPE, "ros2msg", text.encode())
    channel = writer.register_channel(topic, "cdr", schema)
    for number, (stamp_ns, row) in enumerate(zip(stamps_ns.tolist(), rows, strict=True)):
        data = _CDR + row.tobytes()
        writer.add_message(channel, log_time=stamp_ns, publish_time=stamp_ns, sequence=number, data=data)
    writer.finish()

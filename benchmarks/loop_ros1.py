"""A loop over messages with ROS 1's own rosbag, as people write it today; needs the Python that has it.

python benchmarks/loop_ros1.py IN OUT
"""

from __future__ import annotations

import sys
from pathlib import Path

import rosbag
from loop_noise import MOVED, shake


def loop(source: Path, target: Path) -> None:
    """Rewrite with ROS 1's own rosbag; needs the Python that has it."""
    with rosbag.Bag(str(source)) as reader, rosbag.Bag(str(target), "w", compression="lz4") as writer:
        for topic, message, time in reader.read_messages(raw=False):
            if message._type in MOVED:  # noqa: SLF001 - the API there is
                shake(message)
            writer.write(topic, message, time)


if __name__ == "__main__":
    loop(Path(sys.argv[1]), Path(sys.argv[2]))

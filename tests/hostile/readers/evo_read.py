"""evo's own way into bags: how many poses, and the first one."""

# ruff: noqa: T201 - the answer goes to stdout

import json
import sys
from pathlib import Path

from evo.tools import file_interface
from rosbags.rosbag1 import Reader as Rosbag1Reader
from rosbags.rosbag2 import Reader as Rosbag2Reader

if sys.argv[1] != "--there":
    path = Path(sys.argv[1])
    with Rosbag1Reader(path) if path.suffix == ".bag" else Rosbag2Reader(path) as reader:
        trajectory = file_interface.read_bag_trajectory(reader, "/odom")
    print(json.dumps({"odometry": trajectory.num_poses, "first": trajectory.positions_xyz[0].tolist()}))

"""The rosbags library: counts by topic and the first odometry position."""

# ruff: noqa: T201 - the answer goes to stdout

import collections
import json
import sys
from pathlib import Path

from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_typestore

if sys.argv[1] != "--there":
    counts, first = collections.Counter(), None
    with AnyReader([Path(sys.argv[1])], default_typestore=get_typestore(Stores.ROS2_HUMBLE)) as reader:
        for connection, _, data in reader.messages():
            counts[connection.topic] += 1
            if first is None and connection.topic == "/odom":
                place = reader.deserialize(data, connection.msgtype).pose.pose.position
                first = [place.x, place.y, place.z]
    print(json.dumps({"counts": counts, "first": first}))

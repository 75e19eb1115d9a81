"""ROS 1's own rosbag: counts by topic and the first odometry position."""

# ruff: noqa: T201 - the answer goes to stdout

import collections
import json
import sys

import rosbag

if sys.argv[1] != "--there":
    counts, first = collections.Counter(), None
    for topic, message, _ in rosbag.Bag(sys.argv[1]).read_messages():
        counts[topic] += 1
        if first is None and topic == "/odom":
            place = message.pose.pose.position
            first = [place.x, place.y, place.z]
    print(json.dumps({"counts": counts, "first": first}))

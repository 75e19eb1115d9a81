"""A ROS 1 node that counts odometry until nothing more comes."""

# ruff: noqa: T201 - the answer goes to stdout

import json
import sys
import time

import rospy
from nav_msgs.msg import Odometry

seen = []
rospy.init_node("listener", disable_signals=True)
rospy.Subscriber("/odom", Odometry, lambda _: seen.append(time.monotonic()), queue_size=10_000)
begun = time.monotonic()
while time.monotonic() - begun < 20 and not (seen and time.monotonic() - seen[-1] > 2):
    time.sleep(0.05)
print(json.dumps(len(seen)))
sys.stdout.flush()
rospy.signal_shutdown("heard all")

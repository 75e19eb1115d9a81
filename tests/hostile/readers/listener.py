"""A ROS 1 node that counts odometry until nothing more comes; with --tf2, how far off tf2 is, and the last position."""

# ruff: noqa: T201 - the answer goes to stdout

import json
import sys
import time

import rospy
from nav_msgs.msg import Odometry

seen, said = [], {}
rospy.init_node("listener", disable_signals=True)
if "--tf2" in sys.argv:
    import tf2_ros

    buffer = tf2_ros.Buffer(rospy.Duration(1000))
    listener = tf2_ros.TransformListener(buffer)
rospy.Subscriber("odom", Odometry, lambda message: seen.append((time.monotonic(), message)), queue_size=10_000)
begun = time.monotonic()
while time.monotonic() - begun < 20 and not (seen and time.monotonic() - seen[-1][0] > 2):
    time.sleep(0.05)
if "--tf2" in sys.argv:
    off = []
    for _, odom in seen:
        edge = buffer.lookup_transform(odom.header.frame_id, odom.child_frame_id, odom.header.stamp).transform
        place, turn = odom.pose.pose.position, odom.pose.pose.orientation
        off += [abs(getattr(edge.translation, axis) - getattr(place, axis)) for axis in "xyz"]
        off += [abs(getattr(edge.rotation, axis) - getattr(turn, axis)) for axis in "xyzw"]
    said = {"off": max(off), "end": [place.x, place.y]}
print(json.dumps({"count": len(seen), **said}))
sys.stdout.flush()
rospy.signal_shutdown("heard all")

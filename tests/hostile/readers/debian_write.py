"""Write a ROS 1 bag again by ROS's own rosbag, with its own definitions, of the topics whose types are installed."""

import sys

import rosbag
from roslib.message import get_message_class

with rosbag.Bag(sys.argv[2], "w", compression="lz4", chunk_threshold=6000) as out:
    for topic, raw, stamp in rosbag.Bag(sys.argv[1]).read_messages(raw=True):
        kind = get_message_class(raw[0])
        if kind is not None:
            message = kind()
            message.deserialize(raw[1])
            out.write(topic, message, stamp)

"""The mcap library with its ROS decoders, checksums checked: counts by topic and the first odometry position."""

# ruff: noqa: T201 - the answer goes to stdout

import collections
import json
import sys

from mcap.reader import make_reader
from mcap_ros1.decoder import DecoderFactory as Ros1
from mcap_ros2.decoder import DecoderFactory as Ros2

if sys.argv[1] != "--there":
    counts, first = collections.Counter(), None
    with open(sys.argv[1], "rb") as stream:  # noqa: PTH123 - a path from the command line
        reader = make_reader(stream, decoder_factories=[Ros1(), Ros2()], validate_crcs=True)
        for _, channel, _, message in reader.iter_decoded_messages():
            counts[channel.topic] += 1
            if first is None and channel.topic == "/odom":
                place = message.pose.pose.position
                first = [place.x, place.y, place.z]
        if reader.get_summary().statistics.message_count != sum(counts.values()):
            sys.exit("statistics tell of another number of messages")
    print(json.dumps({"counts": counts, "first": first}))

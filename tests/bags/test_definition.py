"""Types that a bag does not bring along are those that ROS itself knows."""

import pytest
from oracles import OFFICE_BAG, OFFICE_MCAP

from odomcorrupt.bags.block import Definition
from odomcorrupt.bags.definition import md5sum_of, retyped, ros_type, with_common_text
from odomcorrupt.bags.open import open_reader
from odomcorrupt.errors import BagError

MD5SUMS = {  # as rosmsg prints them
    "nav_msgs/msg/Odometry": "cd5e73d190d741a2f92e81eda573aca7",
    "tf2_msgs/msg/TFMessage": "94810edda583a504dfda3829e70d7eec",
    "tf/msg/tfMessage": "94810edda583a504dfda3829e70d7eec",
    "geometry_msgs/msg/PoseStamped": "d3812c3cbc69362b77dc0b19b345f8f5",
}
HASHES = {  # as ros2 topic info prints them
    "nav_msgs/msg/Odometry": "RIHS01_3cc97dc7fb7502f8714462c526d369e35b603cfc34d946e3f2eda2766dfec6e0",
    "tf2_msgs/msg/TFMessage": "RIHS01_e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
}


@pytest.mark.parametrize(("msgtype", "md5sum"), MD5SUMS.items())
def test_ros1_types_have_the_md5sums_of_ros(msgtype, md5sum):
    kind = ros_type(msgtype, "ros1")
    assert (kind.name, kind.digest) == (msgtype.replace("/msg", ""), md5sum)
    assert md5sum_of(msgtype, Definition(kind.name, "ros1msg", kind.text.encode(), {})) == md5sum


@pytest.mark.parametrize(("msgtype", "digest"), HASHES.items())
def test_ros2_types_have_the_hashes_of_ros(msgtype, digest):
    assert ros_type(msgtype, "cdr").digest == digest


def test_md5sums_follow_from_the_definitions_of_bags():
    with open_reader(OFFICE_BAG) as reader:
        for channel in reader.channels.values():
            definition = reader.definition(channel)
            assert md5sum_of(channel.msgtype, definition) == definition.metadata["md5sum"]


def test_no_md5sum_follows_from_an_incomplete_definition():
    with open_reader(OFFICE_MCAP.with_name("incomplete.mcap")) as reader:
        (door,) = (channel for channel in reader.channels.values() if channel.topic == "/door")
        with pytest.raises(BagError, match="office_msgs"):
            md5sum_of(door.msgtype, reader.definition(door))


def test_a_retyped_topic_keeps_its_publisher_and_takes_the_bags_own_definition():
    with open_reader(OFFICE_MCAP) as reader:
        topics = {channel.topic: channel for channel in reader.channels.values()}
        like = reader.definition(topics["/tf_static"])
        made = retyped(reader, "nav_msgs/msg/Odometry", topics["/tf_static"])
        odom = reader.definition(topics["/odom"])
        assert made[:3] == odom[:3]
        assert made.metadata["offered_qos_profiles"] == like.metadata["offered_qos_profiles"]
        assert made.metadata["topic_type_hash"] == odom.metadata["topic_type_hash"]
        with pytest.raises(BagError, match="office_msgs/msg/Window"):
            retyped(reader, "office_msgs/msg/Window", topics["/tf_static"])


def test_a_type_that_is_unknown_stays_without_text():
    nothing = Definition("office_msgs/msg/Window", "", b"", {})
    assert with_common_text(nothing, "office_msgs/msg/Window", "cdr") == nothing
    assert b"geometry_msgs/TransformStamped" in with_common_text(nothing, "tf2_msgs/msg/TFMessage", "cdr").text

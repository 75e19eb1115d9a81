"""TF edges left out of messages, against another library's serialisation."""

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from odomcorrupt.bags.block import Channel
from odomcorrupt.bags.convert.tf_edges import split_edge, without_edges
from odomcorrupt.errors import TopicError

TF = "tf2_msgs/msg/TFMessage"
STORES = {"ros1": get_typestore(Stores.ROS1_NOETIC), "cdr": get_typestore(Stores.ROS2_HUMBLE)}
STORES["ros1"].register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", TF))


def serialised(encoding, edges, order):
    store = STORES[encoding]
    kinds = {name: store.types[f"geometry_msgs/msg/{name}"] for name in ("Transform", "Vector3", "Quaternion")}
    seq = {"seq": 7} if encoding == "ros1" else {}
    transforms = []
    for number, (parent, child) in enumerate(edges):
        stamp = store.types["builtin_interfaces/msg/Time"](sec=5 + number, nanosec=number)
        header = store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=parent, **seq)
        moved = kinds["Transform"](kinds["Vector3"](number, 2.0, 3.0), kinds["Quaternion"](0.0, 0.0, 0.6, 0.8))
        transforms.append(store.types["geometry_msgs/msg/TransformStamped"](header, child, moved))
    message = store.types[TF](transforms)
    if encoding == "ros1":
        return bytes(store.serialize_ros1(message, TF))
    return bytes(store.serialize_cdr(message, TF, little_endian=order == "little"))


@pytest.mark.parametrize(("encoding", "order"), [("ros1", "little"), ("cdr", "little"), ("cdr", "big")])
def test_a_message_without_an_edge_is_the_message_of_the_other_edges(encoding, order):
    rng = np.random.default_rng(3)
    channel = Channel(1, "/tf", TF, encoding)
    for _ in range(60):
        frames = ["f" * int(n) for n in rng.integers(1, 12, 8)]
        edges = [(str(rng.choice(frames)), str(rng.choice(frames))) for _ in range(rng.integers(1, 6))]
        gone = frozenset(edges[i] for i in rng.integers(0, len(edges), rng.integers(1, 3)))
        after = without_edges(serialised(encoding, edges, order), channel, gone)
        left = [(i, edge) for i, edge in enumerate(edges) if edge not in gone]
        if not left:
            assert after is None
            continue
        # the numbers of a transform are those of its place in the message as it was
        expected = STORES[encoding]
        read = expected.deserialize_ros1 if encoding == "ros1" else expected.deserialize_cdr
        found = [
            (int(t.header.stamp.sec) - 5, (t.header.frame_id, t.child_frame_id)) for t in read(after, TF).transforms
        ]
        assert found == left
        assert all(t.transform.translation.x == t.header.stamp.sec - 5 for t in read(after, TF).transforms)
        if [i for i, _ in left] == list(range(len(left))):
            assert after.rstrip(b"\0") == serialised(encoding, [edge for _, edge in left], order).rstrip(b"\0")
    untouched = serialised(encoding, [("map", "odom"), ("odom", "base")], order)
    assert without_edges(untouched, channel, frozenset({("odom", "map")})) == untouched


def test_an_edge_may_have_dots_and_must_be_of_tf():
    channels = [Channel(1, "/tf", TF, "cdr"), Channel(2, "/a:b.c", "std_msgs/msg/String", "cdr")]
    assert split_edge("/tf:map.odom", channels) == ("tf", frozenset({("map", "odom")}))
    assert split_edge("tf:a.b./c", channels)[1] == {("a", "b./c"), ("a.b", "c")}
    assert split_edge("/a:b.c", channels) == ("a:b.c", frozenset())
    assert split_edge("/tf:map.odom", None) == ("tf", frozenset({("map", "odom")}))
    for wrong in ("/tf:map", "/no:map.odom", "/no"):
        with pytest.raises(TopicError, match="name one of these"):
            split_edge(wrong, channels)

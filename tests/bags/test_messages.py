"""Layouts against the rosbags serialiser, an independent oracle."""

from operator import attrgetter

import numpy as np
import pytest
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from odomcorrupt.bags.block import TABLE, Block, Channel
from odomcorrupt.bags.messages import (
    READABLE,
    gather,
    gather_stamps_ns,
    locate,
    scatter,
    scatter_columns,
    scatter_stamps_ns,
)
from odomcorrupt.errors import BagError

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf/msg/tfMessage"))
ROS2 = get_typestore(Stores.ROS2_HUMBLE)
ROS2.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf/msg/tfMessage"))
for types in (ROS1, ROS2):
    for kind, name, sides in (("int32", "WheelTicks", "ticks"), ("float32", "WheelVels", "velocity")):
        text = f"std_msgs/Header header\n{kind} {sides}_left\n{kind} {sides}_right"
        types.register(get_types_from_msg(text, f"irobot_create_msgs/msg/{name}"))
WIRES = ["ros1", "little", "big", "xcdr2"]


def store(wire):
    return ROS1 if wire == "ros1" else ROS2


def encoding(wire):
    return "ros1" if wire == "ros1" else "cdr"


def build(types, name, rng, **given):
    """Fill a message of any type with random numbers and strings."""
    cls = types.types[name]
    values = {}
    for field, (node, desc) in types.fielddefs[name][1]:
        if field in given:
            values[field] = given[field]
        elif int(node) == 1:
            kind = desc[0]
            if kind == "string":
                values[field] = "".join(rng.choice(list("abcdefgh"), size=rng.integers(0, 9)))
            else:
                number = np.float32(rng.normal()) if kind.startswith("float") else rng.integers(0, 100)
                values[field] = number.item()
        elif int(node) == 2:
            inner = {k: given[k] for k in ("frame_id", "child_frame_id") if k in given}
            values[field] = build(types, desc, rng, **inner)
        elif int(node) == 3:
            values[field] = rng.normal(size=desc[1])
        elif int(desc[0][0]) == 1:
            count, kind = given.get("count", 2), desc[0][1][0]
            values[field] = (
                [f"{field} {i}" for i in range(count)] if kind == "string" else rng.normal(size=count).astype(kind)
            )
        else:
            values[field] = [build(types, desc[0][1], rng, **given) for _ in range(given.get("count", 2))]
    return cls(**values)


def serialise(wire, message, name):
    if wire == "ros1":
        return bytes(ROS1.serialize_ros1(message, name))
    data = bytes(ROS2.serialize_cdr(message, name, little_endian=wire != "big"))
    return data if wire != "xcdr2" else to_xcdr2(message, name)


def to_xcdr2(message, name):  # noqa: C901 - a branch for each kind of field
    """Serialise plainly with doubles aligned to four bytes."""
    out = bytearray(b"\x00\x07\x00\x00")

    def put(value, kind):
        size = np.dtype(kind).itemsize
        out.extend(b"\0" * ((4 - len(out)) % min(size, 4)))
        out.extend(np.array(value, dtype=kind).tobytes())

    def write(value, name):
        for field, (node, desc) in ROS2.fielddefs[name][1]:
            member = getattr(value, field)
            if int(node) == 1 and desc[0] == "string":
                put(len(member) + 1, "<u4")
                out.extend(member.encode() + b"\0")
            elif int(node) == 1:
                put(member, np.dtype(desc[0]).newbyteorder("<"))
            elif int(node) == 2:
                write(member, desc)
            elif int(node) == 3:
                put(member, "<f8")
            else:
                put(len(member), "<u4")
                for one in member:
                    write_one(one, desc[0][1])

    def write_one(one, kind):
        if isinstance(one, str):
            put(len(one) + 1, "<u4")
            out.extend(one.encode() + b"\0")
        elif isinstance(one, float | np.floating):
            put(one, np.asarray(one).dtype)
        else:
            write(one, kind)

    write(message, name)
    return bytes(out)


def block_of(messages, lead=3):
    """Put messages at odd places of a buffer, as chunks do."""
    data = bytearray(b"\xaa" * lead)
    table = np.zeros(len(messages), TABLE)
    for row, message in zip(table, messages, strict=True):
        row["offset"], row["length"] = len(data), len(message)
        data += message + b"\xbb" * lead
    return Block(np.frombuffer(data, np.uint8), table)


PATHS = {
    "imu orientation": "orientation.x orientation.y orientation.z orientation.w",
    "stamped twist": " ".join(f"twist.{part}.{axis}" for part in ("linear", "angular") for axis in "xyz"),
    "limits": "range_min range_max", "ranges": "ranges",
    "linear_acceleration": "linear_acceleration.x linear_acceleration.y linear_acceleration.z",
    "angular_velocity": "angular_velocity.x angular_velocity.y angular_velocity.z",
    "lla": "latitude longitude altitude", "covariance": "position_covariance",
    "twist": " ".join(f"twist.twist.{part}.{axis}" for part in ("linear", "angular") for axis in "xyz"),
    "twist_covariance": "twist.covariance", "pose_covariance": "pose.covariance",
    "transform position": "transform.translation.x transform.translation.y transform.translation.z",
    "transform orientation": "transform.rotation.x transform.rotation.y transform.rotation.z transform.rotation.w",
    "point position": "point.x point.y point.z", "pose position": "position.x position.y position.z",
    "pose orientation": "orientation.x orientation.y orientation.z orientation.w",
}  # fmt: skip


def oracle(message, field, index=0):
    """Return the numbers of a field of an item, from the decoded message."""
    if field in ("position", "orientation"):
        field = next((f"{n} {field}" for n in ("transform", "point", "pose") if hasattr(message, n)), f"imu {field}")
        while field.startswith("pose") and hasattr(message, "pose"):
            message = message.pose
    if field in getattr(message, "name", ()):
        return [getattr(message, ("position", "velocity")[index])[message.name.index(field)]]
    if field == "wheels":
        return [value for name, value in vars(message).items() if name not in ("header", "__msgtype__")]
    if field == "twist" and not hasattr(message.twist, "covariance"):
        field = "stamped twist"
    found = [attrgetter(path)(message) for path in PATHS[field].split()]
    return list(found[0]) if np.ndim(found[0]) else found


def odometry(wire, count, seed):
    """Return a block of odometry of one robot, and its layout."""
    rng, name = np.random.default_rng(seed), "nav_msgs/msg/Odometry"
    messages = [build(store(wire), name, rng, frame_id="odom", child_frame_id="base") for _ in range(count)]
    block = block_of([serialise(wire, m, name) for m in messages])
    (layout,) = locate(block, Channel(0, "/odom", name, encoding(wire)))
    return block, layout


def stamp_ns(header):
    return header.stamp.sec * 10**9 + header.stamp.nanosec


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("msgtype", sorted(READABLE))
def test_fields_are_what_another_decoder_reads(msgtype, wire):
    rng = np.random.default_rng(1)
    messages = [build(store(wire), msgtype, rng, count=n % 4) for n in range(40)]
    block = block_of([serialise(wire, m, msgtype) for m in messages])
    layouts = locate(block, Channel(0, "/t", msgtype, encoding(wire)))
    assert sorted(row for layout in layouts for row in layout.rows) == list(range(40))
    for layout in layouts:
        for index, item in enumerate(layout.items):
            parts = [getattr(messages[row], "transforms", [messages[row]] * 9)[index] for row in layout.rows]
            heads = [getattr(p, "header", None) for p in parts]
            assert {head.frame_id if head else "" for head in heads} == {item.frame_id}
            assert {getattr(p, "child_frame_id", "") for p in parts} == {item.child_frame_id}
            assert gather_stamps_ns(block, layout, item).tolist() == [stamp_ns(head) if head else 0 for head in heads]
            for field in item.fields:
                np.testing.assert_array_equal(
                    gather(block, layout, item, field), [oracle(p, field, index) for p in parts]
                )


@pytest.mark.parametrize("wire", WIRES)
def test_scattered_numbers_are_read_by_gather_and_nothing_else_changes(wire):
    block, layout = odometry(wire, 50, 2)
    before = block.data.copy()
    (item,) = layout.items
    stamps_ns = gather_stamps_ns(block, layout, item)
    scatter_stamps_ns(block, layout, item, stamps_ns + 5)
    for field, (_, count) in item.fields.items():
        values = gather(block, layout, item, field)
        scatter(block, layout, item, field, values + 1)
        np.testing.assert_array_equal(gather(block, layout, item, field), values + 1)
        scatter(block, layout, item, field, values)
        assert values.shape == (50, count)
    assert gather_stamps_ns(block, layout, item).tolist() == (stamps_ns + 5).tolist()
    scatter_stamps_ns(block, layout, item, stamps_ns)
    np.testing.assert_array_equal(block.data, before)


@pytest.mark.parametrize("wire", WIRES)
def test_columns_are_scattered_into_the_messages_that_are_named_and_into_nothing_else(wire):
    block, layout = odometry(wire, 9, 4)
    (item,) = layout.items
    expected = gather(block, layout, item, "pose_covariance")
    which = np.arange(9) % 2 == 1
    values = np.random.default_rng(5).normal(size=(5, 9))
    expected[np.ix_(which, [0, 1, 5, 6, 35])] = values.T[which]
    scatter_columns(block, layout, item, "pose_covariance", [0, 1, 5, 6, 35], values, which)
    np.testing.assert_array_equal(gather(block, layout, item, "pose_covariance"), expected)
    scatter_columns(block, layout, item, "twist", [5], [np.full(9, 3.0)])
    assert (gather(block, layout, item, "twist")[:, 5] == 3.0).all()
    whole, _ = odometry(wire, 9, 4)
    scatter(whole, layout, item, "pose_covariance", expected)
    scatter(whole, layout, item, "twist", gather(block, layout, item, "twist"))
    np.testing.assert_array_equal(block.data, whole.data)


@pytest.mark.parametrize("wire", WIRES)
def test_a_message_that_differs_in_any_structural_byte_has_a_layout_of_its_own(wire):
    name = "nav_msgs/msg/Odometry"
    child = "base_footprint"
    for frame in ("o", "odom", "odometry"):
        for place in range(len(child)):
            other = child[:place] + "X" + child[place + 1 :]
            rng = np.random.default_rng(5)
            pair = [build(store(wire), name, rng, frame_id=frame, child_frame_id=c) for c in (child, other, child)]
            block = block_of([serialise(wire, m, name) for m in pair])
            found = locate(block, Channel(0, "/odom", name, encoding(wire)))
            assert [(one.rows.tolist(), one.items[0].child_frame_id) for one in found] == [
                ([0, 2], child),
                ([1], other),
            ]


def test_messages_of_equal_length_with_different_strings_have_layouts_of_their_own():
    rng = np.random.default_rng(3)
    name = "nav_msgs/msg/Odometry"
    frames = [("odom", "base_link", 0), ("odomm", "base_lin", 1)]
    built = [build(ROS1, name, rng, frame_id=f, child_frame_id=c) for f, c, _ in frames * 10]
    messages = [serialise("ros1", one, name) for one in built]
    assert len({len(m) for m in messages}) == 1
    layouts = locate(block_of(messages), Channel(0, "/odom", name, "ros1"))
    assert [layout.rows.tolist() for layout in layouts] == [list(range(0, 20, 2)), list(range(1, 20, 2))]


@pytest.mark.parametrize("wire", WIRES)
@pytest.mark.parametrize("msgtype", sorted(READABLE))
def test_a_message_cut_anywhere_is_an_error_or_complete(msgtype, wire):
    message = build(store(wire), msgtype, np.random.default_rng(4), frame_id="odom", child_frame_id="base")
    data = serialise(wire, message, msgtype)
    channel = Channel(0, "/t", msgtype, encoding(wire))
    (whole,) = locate(block_of([data]), channel)
    end = max(offset + int(item.number[1]) * count for item in whole.items for offset, count in item.fields.values())
    for length in {*range(0, end, 5), end - 1}:
        with pytest.raises(BagError, match="/t"):
            locate(block_of([data[:length]]), channel)
    locate(block_of([data[:end]]), channel)


def test_a_count_beyond_the_message_is_an_error_at_once():
    channel = Channel(0, "/tf", "tf2_msgs/msg/TFMessage", "cdr")
    with pytest.raises(BagError, match="/tf: a message of 8 bytes"):
        locate(block_of([b"\0\1\0\0\xff\xff\xff\xff"]), channel)


@pytest.mark.parametrize("header", [b"\0\3\0\0", b"\0\x09\0\0", b"\1\1\0\0"])
def test_an_encoding_that_is_not_plain_is_refused(header):
    with pytest.raises(BagError, match="representation"):
        locate(block_of([header + bytes(800)]), Channel(0, "/odom", "nav_msgs/msg/Odometry", "cdr"))


def test_unknown_types_encodings_and_lying_tables_are_refused():
    block = block_of([bytes(800)])
    with pytest.raises(BagError, match="std_msgs/msg/String"):
        locate(block, Channel(0, "/s", "std_msgs/msg/String", "cdr"))
    with pytest.raises(BagError, match="json"):
        locate(block, Channel(0, "/odom", "nav_msgs/msg/Odometry", "json"))
    block.table["length"] = 900
    with pytest.raises(BagError, match="beyond its block"):
        locate(block, Channel(0, "/odom", "nav_msgs/msg/Odometry", "cdr"))


def test_a_stamp_that_does_not_fit_is_refused():
    name = "geometry_msgs/msg/PointStamped"
    block = block_of([serialise("ros1", build(ROS1, name, np.random.default_rng(5)), name)])
    (layout,) = locate(block, Channel(0, "/p", name, "ros1"))
    with pytest.raises(BagError, match="do not fit"):
        scatter_stamps_ns(block, layout, layout.items[0], np.array([-1]))


def test_a_channel_without_messages_has_no_layouts():
    assert locate(block_of([]), Channel(0, "/odom", "nav_msgs/msg/Odometry", "cdr")) == []

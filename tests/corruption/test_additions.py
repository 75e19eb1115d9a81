"""Truth kept beside, the correction as a transform, localisation kept, and TF that drives alone."""

import numpy as np
import pytest
from bagged import IMU, ODOM, TF, MemoryBag, blocks_of, driven, messages_of, planar, robot, transforms
from drives import model, office

from odomcorrupt.bags.block import TABLE, Block, Channel
from odomcorrupt.bags.messages import gather_stamps_ns, locate, pack_transform
from odomcorrupt.corruption.transform import Options, Transform
from odomcorrupt.errors import TopicError
from odomcorrupt.geometry.se2 import compose, inverse, wrap

DRIVE = office(20.0, 10.0)
CHANNELS = {c.id: c for c in (ODOM, TF, IMU)}


class MemoryWriter:
    """A writer that remembers which channels were added."""

    keeps_rest = False

    def __init__(self):
        self.channels = {}

    def add_channel(self, topic, msgtype, like):
        channel = Channel(100 + len(self.channels), topic, msgtype, like.encoding)
        self.channels[channel.id] = channel
        return channel


def run(messages, *, channels=None, complete=True, **options):
    transform, writer = Transform(model(), 1, 0, Options(**options)), MemoryWriter()
    bag = MemoryBag(blocks_of(messages), CHANNELS if channels is None else channels, complete)
    return list(transform.blocks(bag, "test.mcap", writer)), transform, writer


def added(blocks, channel):
    """Return what was added on a channel, as one block."""
    messages = [message for block in blocks for message in block.added if message.channel == channel.id]
    table = np.zeros(len(messages), dtype=TABLE)
    table["channel"], table["log_ns"] = channel.id, [message.log_ns for message in messages]
    table["length"] = [len(message.data) for message in messages]
    table["offset"] = np.cumsum(table["length"]) - table["length"]
    return Block(np.frombuffer(b"".join(message.data for message in messages), np.uint8).copy(), table)


def assert_same(ours, theirs, tolerance=1e-9):
    assert np.abs((ours - theirs)[..., :2]).max() < tolerance
    assert np.abs(wrap((ours - theirs)[..., 2])).max() < tolerance


def test_the_truth_is_kept_to_the_bit_beside_the_noisy_odometry():
    messages = robot(*DRIVE)
    out, transform, writer = run(messages, keep_truth="/odom_truth")
    (truth,) = writer.channels.values()
    assert (truth.topic, truth.msgtype, truth.encoding) == ("/odom_truth", ODOM.msgtype, "cdr")
    clean = [(log, data) for channel, log, data in messages if channel is ODOM]
    assert [(log, data) for _, log, data in messages_of([added(out, truth)])] == clean
    assert transform.truth.count == len(clean)
    assert not np.array_equal(planar(out, ODOM), planar(blocks_of(messages), ODOM))


@pytest.mark.parametrize("name", ["imu", "", "two words", "'/odom'", "/", "/9", "odom/"])
def test_the_truth_replaces_no_topic_and_needs_a_name_that_a_topic_can_have(name):
    with pytest.raises(TopicError, match="imu: is in the bag already" if name == "imu" else "is not a topic name"):
        run(robot(*DRIVE), keep_truth=name)


def without_localisation(t, poses):
    return driven(t, poses, ("odom", "base_link", np.asarray))


def test_the_correction_as_a_transform_leaves_every_message_and_leads_to_the_same_poses():
    messages = without_localisation(*DRIVE)
    out, transform, writer = run(messages, new_odom_frame="odom1")
    assert messages_of(out) == messages_of(blocks_of(messages))
    (channel,) = writer.channels.values()
    assert (channel.topic, channel.msgtype) == ("/tf", TF.msgtype)
    block = added(out, channel)
    (layout,) = locate(block, channel)
    (item,) = layout.items
    assert (item.frame_id, item.child_frame_id) == ("odom1", "odom")
    assert np.array_equal(gather_stamps_ns(block, layout, item), DRIVE[0])
    noisy = planar(run(messages)[0], ODOM)
    assert_same(compose(planar([block], channel), DRIVE[1]), noisy)
    assert transform.run.edge.count == len(noisy)


def test_the_correction_is_no_second_parent_of_odom():
    with pytest.raises(TopicError, match="odom already has a parent, map"):
        run(robot(*DRIVE), new_odom_frame="odom1")


@pytest.mark.parametrize("frame", ["odom", "/odom", ""])
def test_the_correction_is_no_transform_of_odom_to_itself(frame):
    with pytest.raises(TopicError, match="must be a new frame"):
        run(without_localisation(*DRIVE), new_odom_frame=frame)


@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
@pytest.mark.parametrize("frames", [("a", "b"), ("odom1", "odom"), ("robot/odometry", "x" * 13)])
def test_a_packed_transform_is_read_back_by_other_peoples_code(encoding, frames):
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC if encoding == "ros1" else Stores.ROS2_HUMBLE)
    name = "tf2_msgs/msg/TFMessage"
    if name not in store.types:
        store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", name))
    data = pack_transform(encoding, 1_700_000_000_123_456_789, frames, (1.5, -2.0, 0.6))
    message = store.deserialize_ros1(data, name) if encoding == "ros1" else store.deserialize_cdr(data, name)
    (edge,) = message.transforms
    assert (edge.header.frame_id, edge.child_frame_id) == frames
    assert (edge.header.stamp.sec, edge.header.stamp.nanosec) == (1_700_000_000, 123_456_789)
    q = edge.transform.rotation
    assert (edge.transform.translation.x, edge.transform.translation.y) == (1.5, -2.0)
    assert 2 * np.arctan2(q.z, q.w) == pytest.approx(0.6)
    again = store.serialize_ros1(message, name) if encoding == "ros1" else store.serialize_cdr(message, name)
    assert bytes(again) == data


@pytest.mark.parametrize("turned", [False, True])
def test_localisation_can_be_moved_so_that_the_robot_stays_where_it_is_on_the_map(turned):
    t, poses = DRIVE
    on_map = np.array([0.5, 0.2, 0.1])
    edge = ("odom", "map", inverse(on_map)) if turned else ("map", "odom", on_map)
    messages = driven(t, poses, ("odom", "base_link", np.asarray), edge)
    out, transform, _ = run(messages, keep_localisation=True)
    localisation = planar(out, TF, edge[:2])
    map_to_odom = inverse(localisation) if turned else localisation
    assert_same(compose(map_to_odom, planar(out, TF, ("odom", "base_link"))), compose(on_map, poses))
    assert np.abs(localisation - localisation[0]).max() > 0.01
    assert transform.changes.edges[f"{edge[0]} -> {edge[1]}"] == len(t)


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("complete", "topic"), [(True, None), (True, "/tf"), (False, "/tf")])
def test_a_bag_of_transforms_alone_drifts_like_its_odometry_would(turned, complete, topic):
    t, poses = DRIVE
    edge = (lambda p: ("base_link", "odom", inverse(p))) if turned else (lambda p: ("odom", "base_link", p))
    alone = [(TF, int(s), transforms((s, *edge(p)), (s, "base_link", "x", p))) for s, p in zip(t, poses, strict=True)]
    out, transform, _ = run(
        alone, channels={TF.id: TF}, complete=complete, odom_topic=topic, odom_frame="odom", base_frame="/base_link"
    )
    noisy = planar(out, TF, edge(poses[0])[:2])
    expected = planar(run(driven(t, poses))[0], ODOM)
    assert_same(inverse(noisy) if turned else noisy, expected)
    assert transform.odometry.name == "TF odom -> base_link"


def test_a_bag_of_transforms_alone_needs_its_frames_and_an_edge_between_them():
    alone = [(TF, int(s), transforms((s, "odom", "base_link", p))) for s, p in zip(*DRIVE, strict=True)]
    with pytest.raises(TopicError, match="to corrupt TF alone, name its edge with odom_frame and base_frame"):
        run(alone, channels={TF.id: TF})
    with pytest.raises(
        TopicError, match=r"TF odom -> wheel has no message with a pose \(TF has odom -> base_link\); name one"
    ):
        run(alone, channels={TF.id: TF}, odom_frame="odom", base_frame="wheel")


def test_a_static_edge_is_reported():
    static = Channel(6, "/tf_static", TF.msgtype, "cdr")
    t, poses = DRIVE
    messages = [(static, int(t[0]), transforms((t[0], "odom", "base_link", poses[0])))]
    messages += driven(t, poses)
    _, transform, _ = run(messages, channels=CHANNELS | {6: static})
    assert transform.changes.static == {"odom -> base_link"}

"""Topics and transforms that are added, and those that stay byte for byte."""

import json
import struct

import numpy as np
import pytest
from bagged import IMU, ODOM, TF, MemoryBag, blocks_of, driven, messages_of, odometry, planar, robot, transforms
from drives import model, office

from odomcorrupt.bags.block import TABLE, Block, Channel
from odomcorrupt.bags.messages import gather_stamps_ns, locate, pack_transform
from odomcorrupt.cli import run
from odomcorrupt.corruption.odometry_source import Frames, contains_truth, frame_of, topics_with_true_motion
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


def through(messages, *, channels=None, complete=True, **options):
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
    out, transform, writer = through(messages, keep_truth="/odom_truth")
    (truth,) = writer.channels.values()
    assert (truth.topic, truth.msgtype, truth.encoding) == ("/odom_truth", ODOM.msgtype, "cdr")
    clean = [(log, data) for channel, log, data in messages if channel is ODOM]
    assert [(log, data) for _, log, data in messages_of([added(out, truth)])] == clean
    assert transform.truth.count == len(clean)
    assert not np.array_equal(planar(out, ODOM), planar(blocks_of(messages), ODOM))


@pytest.mark.parametrize("name", ["imu", "", "two words", "'/odom'", "/", "/9", "odom/"])
def test_the_truth_replaces_no_topic_and_needs_a_name_that_a_topic_can_have(name):
    with pytest.raises(TopicError, match="imu: is in the bag already" if name == "imu" else "is not a topic name"):
        through(robot(*DRIVE), keep_truth=name)


def without_localisation(t, poses):
    return driven(t, poses, ("odom", "base_link", np.asarray))


def test_the_correction_as_a_transform_leaves_every_message_and_leads_to_the_same_poses():
    messages = without_localisation(*DRIVE)
    out, transform, writer = through(messages, new_odom_frame="odom1")
    assert messages_of(out) == messages_of(blocks_of(messages))
    (channel,) = writer.channels.values()
    assert (channel.topic, channel.msgtype) == ("/tf", TF.msgtype)
    block = added(out, channel)
    (layout,) = locate(block, channel)
    (item,) = layout.items
    assert (item.frame_id, item.child_frame_id) == ("odom1", "odom")
    assert np.array_equal(gather_stamps_ns(block, layout, item), DRIVE[0])
    noisy = planar(through(messages)[0], ODOM)
    assert_same(compose(planar([block], channel), DRIVE[1]), noisy)
    assert transform.run.edge.count == len(noisy)


def test_the_correction_is_no_second_parent_of_odom():
    with pytest.raises(TopicError, match="odom already has a parent, map"):
        through(robot(*DRIVE), new_odom_frame="odom1")


@pytest.mark.parametrize("frame", ["odom", "/odom", ""])
def test_the_correction_is_no_transform_of_odom_to_itself(frame):
    with pytest.raises(TopicError, match="must be a new frame"):
        through(without_localisation(*DRIVE), new_odom_frame=frame)


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
    out, transform, _ = through(messages, keep_localisation=True)
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
    out, transform, _ = through(
        alone, channels={TF.id: TF}, complete=complete, odom_topic=topic, odom_frame="odom", base_frame="/base_link"
    )
    noisy = planar(out, TF, edge(poses[0])[:2])
    expected = planar(through(driven(t, poses))[0], ODOM)
    assert_same(inverse(noisy) if turned else noisy, expected)
    assert transform.odometry.name == "TF odom -> base_link"


def test_a_bag_of_transforms_alone_needs_its_frames_and_an_edge_between_them():
    alone = [(TF, int(s), transforms((s, "odom", "base_link", p))) for s, p in zip(*DRIVE, strict=True)]
    with pytest.raises(TopicError, match="to corrupt TF alone, name its edge with odom_frame and base_frame"):
        through(alone, channels={TF.id: TF})
    with pytest.raises(
        TopicError, match=r"TF odom -> wheel has no message with a pose \(TF has odom -> base_link\); name one"
    ):
        through(alone, channels={TF.id: TF}, odom_frame="odom", base_frame="wheel")


def test_a_static_edge_is_reported():
    static = Channel(6, "/tf_static", TF.msgtype, "cdr")
    t, poses = DRIVE
    messages = [(static, int(t[0]), transforms((t[0], "odom", "base_link", poses[0])))]
    messages += driven(t, poses)
    _, transform, _ = through(messages, channels=CHANNELS | {6: static})
    assert transform.changes.static == {"odom -> base_link"}


def channel(number, topic, msgtype, encoding="cdr"):
    return Channel(number, topic, msgtype, encoding)


@pytest.mark.parametrize(
    ("topic", "msgtype", "tells"),
    [
        ("/imu", "sensor_msgs/msg/Imu", True), ("/joint_states", "sensor_msgs/msg/JointState", True),
        ("/plan", "nav_msgs/msg/Path", True), ("/amcl_pose", "geometry_msgs/msg/PoseWithCovarianceStamped", True),
        ("/turtle1/pose", "turtlesim/msg/Pose", True), ("/gazebo/model_states", "gazebo_msgs/msg/ModelStates", True),
        ("/global_costmap/costmap", "nav_msgs/msg/OccupancyGrid", True),
        ("/map", "nav_msgs/msg/OccupancyGrid", False), ("/scan", "sensor_msgs/msg/LaserScan", False),
        ("/cmd_vel", "geometry_msgs/msg/TwistStamped", False), ("/goal_pose", "geometry_msgs/msg/PoseStamped", False),
        ("/odom", "nav_msgs/msg/Odometry", False), ("/wheel/odom", "nav_msgs/msg/Odometry", True),
        ("/ticks", "irobot_create_msgs/msg/WheelTicks", True), ("/v", "irobot_create_msgs/msg/WheelVels", True),
        ("/wheel_status", "irobot_create_msgs/msg/WheelStatus", True),
        ("/encoders", "acme_msgs/msg/EncoderStamped", True), ("/state", "turtlebot3_msgs/msg/SensorState", True),
        ("/fmu/out/vehicle_odometry", "px4_msgs/msg/VehicleOdometry", True),
        ("/fmu/out/vehicle_status", "px4_msgs/msg/VehicleStatus", False), ("/left_ticks", "std_msgs/msg/Int32", True),
        ("/lwheel", "std_msgs/msg/Int16", True), ("/wheel/left", "std_msgs/msg/Float32", True),
        ("/steering_wheel", "std_msgs/msg/Float32", False), ("/platform/feedback", "jackal_msgs/msg/Feedback", True),
        ("/left_wheel_speed", "std_msgs/msg/Float32", True), ("/left_wheel_speed_cmd", "std_msgs/msg/Float32", False),
        ("/left_wheel/velocity", "std_msgs/msg/Float64", True), ("/rpm", "std_msgs/msg/Int16MultiArray", True),
        ("/geo", "geographic_msgs/msg/GeoPoseStamped", True), ("/navpvt", "ublox_msgs/msg/NavPVT", True),
        ("/velocity_status", "autoware_vehicle_msgs/msg/VelocityReport", True),
        ("/temperature", "std_msgs/msg/Float32", False),
    ],
)  # fmt: skip
def test_the_type_tells(topic, msgtype, tells):
    assert topics_with_true_motion([channel(1, topic, msgtype)], {"/odom"}, {}, "odom") == ([topic] if tells else [])


def test_what_is_drawn_in_the_odom_frame_tells_and_in_another_does_not():
    cloud = "sensor_msgs/msg/PointCloud2"
    channels = [channel(1, "/obstacles", cloud), channel(2, "/points", cloud)]
    assert topics_with_true_motion(channels, {"/odom"}, {1: "odom", 2: "base_link"}, "/odom") == ["/obstacles"]


def message(encoding, frame, many, order="<"):
    stamp = struct.pack(f"{order}II", 7, 8)
    count = struct.pack(f"{order}I", 1) if many else b""
    if encoding == "ros1":
        return count + struct.pack("<I", 3) + stamp + struct.pack("<I", len(frame)) + frame.encode() + b"rest"
    head = b"\0\1\0\0" if order == "<" else b"\0\0\0\0"
    return head + count + stamp + struct.pack(f"{order}I", len(frame) + 1) + frame.encode() + b"\0rest"


def block_of(data):
    table = np.array([(9, 0, 0, 3), (1, 0, 3, len(data))], dtype=TABLE)
    return Block(np.frombuffer(b"xyz" + data, dtype=np.uint8).copy(), table)


@pytest.mark.parametrize(("encoding", "order"), [("ros1", "<"), ("cdr", "<"), ("cdr", ">")])
@pytest.mark.parametrize("msgtype", ["nav_msgs/msg/OccupancyGrid", "visualization_msgs/msg/MarkerArray"])
@pytest.mark.parametrize("frame", ["odom", "/odom"])
def test_the_frame_is_read_from_the_first_header(encoding, order, msgtype, frame):
    data = message(encoding, frame, "Array" in msgtype, order)
    assert frame_of(block_of(data), channel(1, "/x", msgtype, encoding)) == "odom"


def test_short_messages_other_types_and_other_encodings_say_nothing():
    grid = "nav_msgs/msg/OccupancyGrid"
    assert frame_of(block_of(b"\0\1\0\0"), channel(1, "/x", grid)) is None
    assert frame_of(block_of(message("cdr", "odom", many=False)), channel(1, "/x", "std_msgs/msg/String")) is None
    assert frame_of(block_of(message("cdr", "odom", many=False)), channel(1, "/x", grid, "json")) is None
    assert frame_of(block_of(message("cdr", "odom", many=False)), channel(2, "/x", grid)) is None


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_grid_in_the_odom_frame_is_named_whatever_the_bag_is_stored_as(tmp_path, capsys, invoke, storage):
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_HUMBLE)
    plugin = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}[storage]
    t, poses = office(10.0, 5.0)
    with Writer(tmp_path / "in", version=9, storage_plugin=plugin) as writer:
        odom = writer.add_connection("/odom", "nav_msgs/msg/Odometry", typestore=types)
        grids = {
            frame: writer.add_connection(f"/grid_in_{frame}", "nav_msgs/msg/OccupancyGrid", typestore=types)
            for frame in ("odom", "map")
        }
        for stamp, pose in zip(t.tolist(), poses, strict=True):
            writer.write(odom, stamp, odometry(stamp, pose))
            for frame, grid in grids.items():
                writer.write(grid, stamp, message("cdr", frame, many=False))
    assert json.loads(invoke(["info", tmp_path / "in", "--json"]).out)["still_true"] == ["/grid_in_odom"]
    assert run([str(tmp_path / "in"), str(tmp_path / "out"), "-v", "--seed", "1"]) == 0
    assert "/grid_in_odom: still contains the true motion\n" in capsys.readouterr().err


def test_topics_of_another_robot_say_nothing_of_this_one():
    kinds = {"tf": "tf2_msgs/msg/TFMessage", "odom": "nav_msgs/msg/Odometry", "imu": "sensor_msgs/msg/Imu"}
    names = [f"/robot{number}/{name}" for number in (1, 2) for name in kinds]
    channels = [channel(i, name, kinds[name.rsplit("/", 1)[-1]]) for i, name in enumerate(names)]
    assert topics_with_true_motion(channels, {"/robot1/odom"}, {}, "odom") == ["/robot1/imu"]


@pytest.mark.parametrize(
    ("topic", "parent", "child", "contains"),
    [("/tf", "world", "base_link_gt", True), ("/tf_gt", "a", "b", True),
    ("/tf", "base_link", "wheel_left_link", True), ("/tf", "map", "odom", False),
    ("/tf", "base_link", "laser", False), ("/tf_static", "base_link", "wheel_mount", False),
    ("/tf", "world", "map", False)],
)  # fmt: skip
def test_edges_of_a_truth_and_of_wheels_are_known(topic, parent, child, contains):
    assert contains_truth(topic, parent, child, Frames("odom", "base_link")) == contains

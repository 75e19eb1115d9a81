"""Which topics still tell the truth when the odometry is moved: by type, by frame, by name."""

import json
import struct

import numpy as np
import pytest
from bagged import odometry
from drives import office

from odomcorrupt.bags.block import TABLE, Block, Channel
from odomcorrupt.cli import run
from odomcorrupt.corruption.odometry_source import Frames, contains_truth, frame_of, topics_with_true_motion


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
def test_a_grid_in_the_odom_frame_is_named_whatever_the_bag_is_stored_as(tmp_path, capsys, storage):
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
    assert run(["info", str(tmp_path / "in"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["still_true"] == ["/grid_in_odom"]
    assert run([str(tmp_path / "in"), str(tmp_path / "out"), "-v", "--seed", "1"]) == 0
    assert "a filter which reads them still gets the true motion: /grid_in_odom.\n" in capsys.readouterr().err


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

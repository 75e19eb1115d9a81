"""Bags and maps that are other than expected: what is in them is told, or read as their makers meant it."""

import struct

import numpy as np
import pytest
from mcap.writer import Writer
from packed import grid, scan
from test_grids import written

from odomcorrupt.corruption.transform import Options
from odomcorrupt.errors import BagError, MapError, RecordingError, TopicError
from odomcorrupt.mapping.conditioned import read_map_from_odom, read_odom_frame, read_recorded_map
from odomcorrupt.mapping.messages import mount_at, read_grid, read_scan
from odomcorrupt.mapping.occupancy_grid import FREE, OCCUPIED, UNKNOWN, read_map
from odomcorrupt.mapping.scan_map import read_rays, slow_rays
from odomcorrupt.trajectories import Drive
from rosmessages import STORES

SCAN, GRID = "sensor_msgs/msg/LaserScan", "nav_msgs/msg/OccupancyGrid"
MOUNT = mount_at(np.zeros(3))


def bag(path, *topics):
    """Write an MCAP of topics with their type and messages, a second apart."""
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start(profile="ros2", library="test")
        for name, msgtype, messages in topics:
            text = STORES[2].generate_msgdef(msgtype, ros_version=2)[0]
            channel = writer.register_channel(name, "cdr", writer.register_schema(msgtype, "ros2msg", text.encode()))
            for number, data in enumerate(messages):
                writer.add_message(channel, (5 + number) * 10**9, data, 0)
        writer.finish()
    return path


@pytest.mark.parametrize(
    ("topics", "asked", "words"),
    [
        ([("/map", GRID, [])], None, r"no sensor_msgs/LaserScan topic \(found /map\)"),
        ([], None, "no topic at all"),
        ([("/front", SCAN, []), ("/back", SCAN, [])], None, "/back, /front; name one with scan"),
        ([("/front", SCAN, [])], "/scan", r"no sensor_msgs/LaserScan on /scan \(found /front\)"),
        ([("/map", GRID, [])], "/map", r"\(found none\)"),
    ],
)
def test_laser_that_is_not_there_is_reported_with_those_that_are(tmp_path, topics, asked, words):
    with pytest.raises(TopicError, match=words):
        read_rays(bag(tmp_path / "b.mcap", *topics), asked, "base_link", MOUNT)


def test_topic_without_a_scan_and_laser_without_a_place(tmp_path):
    with pytest.raises(RecordingError, match="/scan holds no scan"):
        read_rays(bag(tmp_path / "b.mcap", ("/scan", SCAN, [])), None, "base_link", MOUNT)
    path = bag(tmp_path / "c.mcap", ("/scan", SCAN, [scan([1.0])]))
    with pytest.raises(TopicError, match=r"'laser' \(TF contains nothing\); give the laser's pose on the robot"):
        read_rays(path, "scan", "base_link", None)


def test_rays_that_met_nothing_or_no_number_are_left_out_and_counted(tmp_path):
    ranges = [1.0, np.nan, np.inf, 10.0, 0.05, 2.0]
    rays = read_rays(bag(tmp_path / "b.mcap", ("/scan", SCAN, [scan(ranges)])), None, "base_link", MOUNT)
    assert rays.notes == ("4 of 6 rays have no return within the laser's range",)
    np.testing.assert_allclose(np.hypot(*rays.to_xy.T), [1.0, 2.0])
    np.testing.assert_allclose(rays.to_xy[0], [np.cos(-0.5), np.sin(-0.5)])
    assert (rays.stamps_ns - 5_000_000_007).tolist() == [0, 5_000_000]  # a millisecond from ray to ray


def test_rays_beside_the_drive_are_left_out_until_none_is(tmp_path):
    stamps = np.arange(11) * 10**8 + 5_000_000_000
    xyt = np.column_stack((np.linspace(0, 1, 11), np.zeros(11), np.zeros(11)))
    drive = some_drive(stamps, xyt)
    late = scan([1.0, 2.0], stamp_ns=7 * 10**9)
    both = read_rays(bag(tmp_path / "b.mcap", ("/scan", SCAN, [scan([1.0, 2.0]), late])), None, "b", MOUNT)
    slow = slow_rays(both, drive, None)
    assert len(slow.rays) == 2
    assert slow.notes == ("2 rays were shot before or after the odometry",)
    turning = some_drive(stamps, np.column_stack((np.zeros((11, 2)), np.linspace(0, 2, 11))))
    with pytest.raises(RecordingError, match=r"none of 4 rays can be used .*2 rays were shot while turning faster"):
        slow_rays(both, turning, 0.5)


def some_drive(stamps_ns, xyt):
    return Drive("/odom", "odom", "base_link", stamps_ns, xyt, np.zeros((len(xyt), 3)))


@pytest.mark.parametrize(
    ("kind", "order", "align"), [(0x01, "<", 8), (0x00, ">", 8), (0x07, "<", 4), (0x06, ">", 4), (0x10, ">", 4)]
)
def test_grid_of_any_plain_cdr_is_read(kind, order, align):
    frame = b"map\0"
    data = struct.pack(f"{order}iII", 1, 2, len(frame)) + frame
    data += struct.pack(f"{order}2IfII", 0, 0, 0.5, 2, 1)
    data += bytes(-len(data) % align)
    data += struct.pack(f"{order}7dI", 1.0, -2.0, 0.0, 0.0, 0.0, 0.0, 1.0, 2) + bytes([100, 255])
    read = read_grid(bytes([0, kind, 0, 0]) + data, "/map", "cdr")
    assert (read.frame_id, read.resolution_m, read.cells.tolist()) == ("map", 0.5, [[100, -1]])
    np.testing.assert_array_equal(read.origin_xyt, [1.0, -2.0, 0.0])


def test_grid_that_makes_no_sense_and_cdr_that_is_not_plain_are_reported():
    whole = grid(np.zeros((2, 2)))
    at = whole.index(struct.pack("<f", 0.05))
    for wrong in (0.0, -1.0, float("nan")):
        with pytest.raises(BagError, match="a grid with resolution"):
            read_grid(whole[:at] + struct.pack("<f", wrong) + whole[at + 4 :], "/map", "cdr")
    turn = whole.index(struct.pack("<2d", np.sin(0.2), np.cos(0.2)))
    with pytest.raises(BagError, match="the message is damaged"):
        read_grid(whole[:turn] + bytes(16) + whole[turn + 16 :], "/map", "cdr")
    with pytest.raises(BagError, match="CDR representation 0x0003 is not a plain one"):
        read_scan(b"\0\3" + scan([1.0])[2:], "/scan", "cdr")


def test_recorded_map_is_read_with_map_servers_thresholds(tmp_path):
    cells = np.array([[0, 25, 26], [64, 65, 100], [-1, 101, 127]])
    path = bag(tmp_path / "b.mcap", ("/map", GRID, [grid(np.zeros((2, 2))), grid(cells)]))
    found = read_recorded_map(path, "map")
    expected = [[FREE, FREE, UNKNOWN], [UNKNOWN, OCCUPIED, OCCUPIED], [UNKNOWN, OCCUPIED, OCCUPIED]]
    assert found.grid.cells.tolist() == expected
    assert found.frame_id == "map"


def test_map_that_is_not_in_the_bag_is_reported_with_those_that_are(tmp_path):
    path = bag(tmp_path / "b.mcap", ("/map", GRID, []), ("/scan", SCAN, [scan([1.0])]))
    with pytest.raises(TopicError, match=r"no nav_msgs/OccupancyGrid on /costmap \(found /map\)"):
        read_recorded_map(path, "/costmap")
    with pytest.raises(TopicError, match=r"on /scan \(found /map\)"):
        read_recorded_map(path, "/scan")
    with pytest.raises(MapError, match="/map holds no map"):
        read_recorded_map(path, "/map")
    assert read_map_from_odom(path, "map", "odom") is None
    with pytest.raises(TopicError):
        read_odom_frame(path, Options())
    empty = bag(tmp_path / "c.mcap", ("/odom", "nav_msgs/msg/Odometry", []))
    with pytest.raises(TopicError, match="/odom has no message with a pose"):
        read_odom_frame(empty, Options())


def test_map_of_fewer_greys_and_a_list_below_its_key(tmp_path):
    yaml = "image: m.pgm\nresolution: 0.5 # metres\norigin:\n- -1.5\n- 2\n- 0.25\nnegate: false\n"
    found = read_map(written(tmp_path, yaml, b"P5\n3 1\n15\n\x0f\x00\x08"))
    assert found.cells.tolist() == [[FREE, OCCUPIED, UNKNOWN]]
    np.testing.assert_array_equal(found.origin_xyt, [-1.5, 2.0, 0.25])


@pytest.mark.parametrize("name", [".", "a" * 5000, "../m.pgm"])
def test_image_that_is_no_file_beside_its_map_is_reported(tmp_path, name):
    yaml = f"image: {name}\nresolution: 0.5\norigin: [0, 0, 0]\n"
    with pytest.raises(MapError):
        read_map(written(tmp_path, yaml, b"P5 1 1 255\n\0"))


def test_file_that_is_too_long_for_a_map_is_none(tmp_path):
    with pytest.raises(MapError, match=r"is not a map's \.yaml"):
        read_map(written(tmp_path, "image: m.pgm\n" * 10_000, b""))

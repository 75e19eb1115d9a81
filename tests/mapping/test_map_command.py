"""Maps drawn by `map` or by strangers, and corruption, samples and batches within a map."""

import csv
import io
import json
import struct
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import Writer
from packed import grid, scan
from test_free_space import written

from odomcorrupt.cli import run
from odomcorrupt.commands._options import pose as pose_of
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.corruption.transform import Options
from odomcorrupt.errors import BagError, MapError, RecordingError, TopicError
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.mapping.conditioned import read_map_from_odom, read_odom_frame, read_recorded_map
from odomcorrupt.mapping.messages import mount_at, read_grid, read_scan
from odomcorrupt.mapping.occupancy_grid import FREE, OCCUPIED, UNKNOWN, Grid, format_map, free_space, read_map
from odomcorrupt.mapping.scan_map import place, read_rays, slow_rays, wall_thickness
from odomcorrupt.model.motion_model import MotionModel
from odomcorrupt.model.presets import preset_named
from odomcorrupt.trajectories import Drive, read_drive, read_poses
from recordings import FIXTURES, OFFICE, RECORDINGS
from rosmessages import STORES

GAZEBO = RECORDINGS / "real" / "rob521_gazebo.mcap"
OLIN = RECORDINGS / "bags" / "olin_tb4" / "macfirst_floor_take_2"


@pytest.mark.recordings
def test_rays_placed_by_the_truth_end_in_the_walls_of_the_real_map():
    truth = read_poses(GAZEBO, "/ground_truth")
    rays = slow_rays(read_rays(GAZEBO, "/scan", "base_link", None), read_drive(GAZEBO, None), 0.1).rays
    ends = place(rays, truth).to_xy[::50]
    real = read_map(RECORDINGS / "bags" / "maps" / "rob521_gazebo.yaml")
    near = np.zeros(len(ends), dtype=bool)
    for dx in (-0.05, 0.0, 0.05):
        for dy in (-0.05, 0.0, 0.05):
            near |= real.states(ends + np.array([dx, dy])) == OCCUPIED
    assert near.mean() > 0.98


@pytest.mark.recordings
def test_walls_thicken_with_distance_through_noisy_odometry_and_stay_crisp_through_the_truth():
    drive, truth = read_drive(GAZEBO, None), read_poses(GAZEBO, "/ground_truth")
    slow = slow_rays(read_rays(GAZEBO, "/scan", "base_link", None), drive, 0.1)
    some = np.arange(len(slow.rays)) % 7 == 0
    rays = replace(slow.rays, stamps_ns=slow.rays.stamps_ns[some], to_xy=slow.rays.to_xy[some])
    travelled = slow.travelled_m[some]
    # the first rooms, all rooms but the start seen again, everything
    marks = travelled.max() * np.array([1 / 6, 1 / 2, 1.0])

    def thickness(path):
        ends = place(rays, path).to_xy
        return np.array([wall_thickness(ends[travelled <= mark], cell_m=0.04) for mark in marks])

    clean = thickness(drive.trajectory)
    np.testing.assert_allclose(thickness(truth), clean, atol=5e-4)
    model = MotionModel(preset_named("typical").noise)
    added = []
    for run_number in range(10):
        error = NoisyPath(model, 1, run_number).feed(drive.stamps_ns, drive.xyt).error_xyt
        added.append(thickness(Trajectory(drive.stamps_ns, drive.xyt + error)) ** 2 - clean**2)
    grown = np.sqrt(np.mean(added, axis=0))
    assert grown[0] < grown[1] < grown[2]
    assert grown[2] > clean[2]


@pytest.mark.slow
@pytest.mark.recordings
def test_turtlebot_recorded_as_sqlite_is_mapped(tmp_path):
    out = tmp_path / "olin.png"
    assert run(["map", str(OLIN), "-o", str(out), "--seed", "1", "--resolution", "0.1"]) == 0
    names = sorted(p.name for p in tmp_path.iterdir())
    assert names == ["olin.png", "olin_clean.pgm", "olin_clean.yaml", "olin_noisy.pgm", "olin_noisy.yaml"]
    assert (read_map(tmp_path / "olin_clean.yaml").cells == OCCUPIED).sum() > 300


def test_zero_noise_makes_the_same_map_and_a_name_with_a_dot_is_that_of_both(tmp_path):
    options = ["--alpha", "0", "0", "0", "0", "--seed", "1", "--resolution", "0.2"]
    assert run(["map", str(OFFICE), "-o", str(tmp_path / "m.v2.png"), *options]) == 0
    names = sorted(p.name for p in tmp_path.iterdir())
    assert names == ["m.v2.png", "m.v2_clean.pgm", "m.v2_clean.yaml", "m.v2_noisy.pgm", "m.v2_noisy.yaml"]
    assert read_map(tmp_path / "m.v2_noisy.yaml").resolution_m == 0.2
    assert (tmp_path / "m.v2_clean.pgm").read_bytes() == (tmp_path / "m.v2_noisy.pgm").read_bytes()


def test_laser_pose_replaces_tf():
    drive = read_drive(OFFICE, None)
    by_tf = read_rays(OFFICE, None, drive.child_frame_id, None)
    by_hand = read_rays(OFFICE, None, "nowhere", mount_at(np.array([*by_tf.from_xy, 0.0])))
    np.testing.assert_allclose(by_hand.to_xy, by_tf.to_xy, atol=1e-9)
    turned = read_rays(OFFICE, None, "nowhere", mount_at(np.array([0.0, 0.0, np.pi / 2])))
    np.testing.assert_allclose(turned.to_xy[:, 1], by_tf.to_xy[:, 0] - by_tf.from_xy[0], atol=1e-9)


@pytest.mark.parametrize(
    ("arguments", "word"),
    [(["--scan", "/nope"], "/scan"), (["--resolution", "0.0001"], "--resolution"), (["--truth", "/imu"], "Imu")],
)
def test_what_cannot_be_mapped_is_reported_in_one_line(arguments, word, invoke):
    lines = invoke(["map", OFFICE, "--seed", "1", *arguments], 1).err.strip().splitlines()
    assert len(lines) == 1
    assert word in lines[0]


ROB521, MAPS = RECORDINGS / "real" / "rob521_gazebo.mcap", RECORDINGS / "bags" / "maps"
OLIN_BAGS = RECORDINGS / "bags" / "olin_tb4"
TURTLEBOT = RECORDINGS / "bags" / "evo" / "nav2_turtlebot.mcap"


def ends(path):
    with path.open() as file:
        return np.array([[float(row["x_m"]), float(row["y_m"])] for row in csv.DictReader(file)])


@pytest.mark.slow
@pytest.mark.recordings
@pytest.mark.parametrize("command", ["sample", "corrupt"])
@pytest.mark.parametrize(
    ("bag", "yaml", "pose", "seed"),
    [
        (ROB521, MAPS / "rob521_gazebo.yaml", "0,0,0", 3),
        (TURTLEBOT, MAPS / "depot.yaml", None, 7),  # TF says where odom is
        # found by laying its scans onto its map
        (OLIN_BAGS / "macfirst_floor_take_2", OLIN_BAGS / "maps" / "mac_1st_floor_final.yaml", "-0.25,0.12,4deg", 7),
    ],
)
def test_no_pose_is_in_a_wall_with_the_map_and_some_are_without(command, bag, yaml, pose, seed, tmp_path, invoke):
    where = [] if pose is None else ["--map-pose", pose]
    found = read_map_from_odom(bag, "map", "odom") if pose is None else np.array(pose_of(pose))
    walls = free_space(read_map(yaml), 0.0, unknown="free", map_from_odom=found)
    with_map = ["--map", str(yaml), *where, "--robot-radius", "0.1", "--unknown", "free"]
    for name, more in (("with", with_map), ("without", [])):
        out = tmp_path / f"{name}{'.csv' if command == 'sample' else bag.suffix}"
        words = {
            "sample": ["sample", str(bag), "-n", "40", "--every", "0.5", "--seed", "3", "-o", str(out)],
            "corrupt": [str(bag), str(out), "--seed", str(seed)],
        }[command]
        assert ("drawn again" in invoke([*words, "--alpha", *["0.1"] * 4, *more]).err) is (name == "with")
        free = walls.free(ends(out) if command == "sample" else read_drive(out, "/odom").xyt[:, :2])
        assert free.all() is np.bool_(name == "with")


@pytest.mark.recordings
def test_lecture_star_is_not_reached_by_a_path(tmp_path):
    arguments = ["sample", "--start", "4,1,20deg", "--end", "6,1.3,0", "--alpha", "0.3", "0.4", "0.2", "0.1"]
    arguments += ["--map", str(MAPS / "rob521_gazebo.yaml"), "--unknown", "free", "--seed", "2", "-o"]
    behind = {}
    for check in ("endpoint", "path"):
        assert run([*arguments, str(tmp_path / f"{check}.csv"), "--map-check", check]) == 0
        xy = ends(tmp_path / f"{check}.csv")
        # over the wall that ends at x = 5, further right than any straight way through the gap leads
        behind[check] = int(((xy[:, 1] > 2.1) & (xy[:, 0] > 5.5)).sum())
    assert behind["endpoint"] > 20
    assert behind["path"] == 0


@pytest.mark.parametrize(
    ("arguments", "code", "word"),
    [(["--map", "/map"], 2, ".yaml"), (["--map-pose", "0,0,0"], 2, "--map"), (["--map", "gone.yaml"], 1, "gone.yaml")],
)
def test_map_that_is_not_there_is_reported_in_one_line(arguments, code, word, invoke):
    lines = invoke(["sample", "--seed", "1", *arguments], code).err.strip().splitlines()
    assert len(lines) == 1
    assert word in lines[0]


ALPHA = ["--alpha", "0.1", "0.1", "0.1", "0.1"]


@pytest.fixture
def corridor(tmp_path):
    """Walls 0.4 m to both sides of the office's own path."""
    xy = read_drive(OFFICE, "/odom").xyt[:, :2]
    low = np.floor(xy.min(axis=0) - 1.0)
    columns, rows = (np.ceil((xy.max(axis=0) + 1.0 - low) / 0.1)).astype(int)
    middle = low + 0.1 * (np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1) + 0.5)
    gap = np.full((rows, columns), np.inf)
    for point in xy[::5]:
        gap = np.minimum(gap, np.hypot(*np.moveaxis(middle - point, -1, 0)))
    image, text = format_map(Grid((gap > 0.4).astype(np.uint8) * OCCUPIED, 0.1, np.append(low, 0.0)), "map.pgm")
    (tmp_path / "map.pgm").write_bytes(image)
    (tmp_path / "map.yaml").write_text(text)
    return tmp_path / "map.yaml"


def feed(monkeypatch, path):
    class Pipe:
        buffer = io.BytesIO(path.read_bytes())

        def isatty(self):
            return False

    monkeypatch.setattr(sys, "stdin", Pipe())


@pytest.mark.slow
def test_file_and_pipe_give_the_same_bytes_and_the_map_is_noted_in_them(corridor, tmp_path, invoke, monkeypatch):
    words = ["--seed", "7", *ALPHA, "--odom-topic", "/odom", "--map", str(corridor), "--map-pose", "0,0,0"]
    said = invoke([OFFICE, tmp_path / "a.mcap", *words, "--robot-radius", "0"]).err
    assert int(said.split("Map: ")[1].split(" of ")[0]) > 100
    feed(monkeypatch, OFFICE)
    assert run(["-", str(tmp_path / "b.mcap"), *words, "--robot-radius", "0"]) == 0
    data = (tmp_path / "a.mcap").read_bytes()
    assert data == (tmp_path / "b.mcap").read_bytes()
    assert b"endpoint, 100 tries, odom at 0.0,0.0,0.0, blocked cells" in data
    assert str(tmp_path).encode() not in data


def test_without_noise_the_file_is_copied(corridor, tmp_path):
    words = [str(OFFICE), str(tmp_path / "a.mcap"), "--alpha", "0", "0", "0", "0", "--seed", "1"]
    assert run([*words, "--map", str(corridor), "--map-pose", "0,0,0"]) == 0
    assert (tmp_path / "a.mcap").read_bytes() == OFFICE.read_bytes()


@pytest.mark.parametrize(
    ("more", "code", "word"),
    [
        (["--map", "MAP"], 1, "TF has nothing between 'map' and 'odom'"),
        (["--map", "/map"], 1, "no nav_msgs/OccupancyGrid on /map"),
        (["--map", "MAP", "--map-pose", "0,0,0", "--effect", "wheel_scale:e=0.02"], 1, "wheel_scale is not noise"),
        (["--map", "MAP", "--map-pose", "0,0,0", "--keep-localisation"], 2, "leave out one"),
        (["--map", "MAP", "--map-pose", "90,0,0"], 1, "the drive begins at"),
        (["--map-pose", "0,0,0"], 2, "needs a map; name it with --map"),
        (["--map-check", "path"], 2, "needs a map; name it with --map"),
        (["--robot-radius", "0.1"], 2, "needs a map; name it with --map"),
    ],
)
def test_what_cannot_be_is_refused_in_one_line_and_leaves_nothing(more, code, word, corridor, tmp_path, invoke):
    words = [str(corridor) if one == "MAP" else one for one in more]
    before = set(tmp_path.iterdir())
    lines = invoke([OFFICE, tmp_path / "out.mcap", *ALPHA, "--seed", "1", *words], code).err.strip().splitlines()
    assert len(lines) == 1
    assert word in lines[0]
    assert set(tmp_path.iterdir()) == before


def test_pipe_needs_a_map_file_and_a_pose(corridor, tmp_path, capsys, monkeypatch):
    for where in (["--map", str(corridor)], ["--map", "/map", "--map-pose", "0,0,0"]):
        feed(monkeypatch, OFFICE)
        assert run(["-", str(tmp_path / "out.mcap"), "--odom-topic", "/odom", "--seed", "1", *where]) == 2
        assert "INPUT is a pipe and read once" in capsys.readouterr().err


@pytest.mark.slow
def test_batches_and_pipes_draw_whole_paths_where_single_increments_are_stuck(corridor, tmp_path, invoke, monkeypatch):
    monkeypatch.chdir(tmp_path)
    short = FIXTURES / "office_ros2"
    # few tries are what narrow places do: an increment is given up soon
    words = [*ALPHA, "--seed", "7", "--map", str(corridor), "--map-pose", "0,0,0", "--robot-radius", "0"]
    words += ["--max-tries", "2", "--odom-topic", "/odom"]
    assert run(["batch", str(short), "runs", "--runs", "3", "--to", "mcap", "-q", *words]) == 0
    whole = 0
    for number in range(3):
        single = tmp_path / f"single{number}.mcap"
        whole += "one of 64 paths, resampled" in invoke([short, single, "--run", number, "-v", *words]).err
        assert single.read_bytes() == (tmp_path / "runs" / f"run_{number:06d}.mcap").read_bytes()
    assert whole > 0
    assert run([str(short), "plain.mcap", "--effect", "wheel_scale:e=0", "-q"]) == 0
    feed(monkeypatch, tmp_path / "plain.mcap")
    assert run(["-", "piped.mcap", "--run", "1", "-q", *words]) == 0
    moved = [read_drive(tmp_path / name, "/odom").xyt for name in ("piped.mcap", "single1.mcap")]
    np.testing.assert_array_equal(*moved)


@pytest.mark.slow
def test_a_fleet_keeps_to_the_map_and_its_commands_name_it(corridor, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, size in (("a.toml", 0.08), ("b.toml", 0.12)):
        noise = "\n".join(f"{one} = {size}" for one in ("rot_rot", "rot_trans", "trans_trans", "trans_rot"))
        Path(name).write_text(f'schema = 1\n[noise]\nlaw = "diffusion"\n{noise}\n')
    words = ["--map", str(corridor), "--map-pose", "0,0,0", "--robot-radius", "0"]
    fleet = ["--fleet", "a.toml", "--fleet", "b.toml"]
    assert run(["batch", str(OFFICE), "runs", "--runs", "2", "--seed", "7", "-q", *fleet, *words]) == 0
    walls = free_space(read_map(corridor), 0.0, unknown="free", map_from_odom=np.zeros(3))
    for line in (tmp_path / "runs" / "manifest.jsonl").read_text().splitlines():
        record = json.loads(line)
        assert "--map" in record["command"]
        assert walls.free(read_drive(tmp_path / "runs" / record["file"], "/odom").xyt[:, :2]).all()


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

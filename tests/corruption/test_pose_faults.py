"""Poses and frames that mean nothing are said, by what looks at a bag and by what corrupts it."""

import sqlite3
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from bagged import ODOM, TF, odometry, quaternion, transforms, write_mcap
from drives import office

from odomcorrupt.cli import run
from odomcorrupt.corruption.pose_faults import PoseFaults, frame_faults

FIXTURES = Path(__file__).parents[2] / "fixtures"
NOISE = ("--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "7")


def test_orientations_of_no_length_and_upright_ones_are_counted():
    quats = np.array([[0, 0, 0, 0], [0, 0, 0, 1], quaternion(1.0, 0.2, np.pi / 2), 3 * quaternion(1.0, 0.0, -1.55)])
    faults = PoseFaults()
    faults.take(np.array([[0, 0, 0], [1e15, 0, 0], [0, -2e9, 0], [np.nan, 0, 0]], dtype=float), quats.astype(float))
    assert (faults.no_orientation, faults.upright, faults.far) == (1, 2, 2)
    faults.take(np.zeros((2, 3)), np.array([quaternion(2.0, 1.0, 1.0), [np.nan] * 4]))
    assert (faults.no_orientation, faults.upright, faults.far) == (1, 2, 2)


TREES = {
    "sound": ([("map", "odom"), ("odom", "base"), ("base", "laser")], []),
    "sound, the other way round": ([("base", "odom"), ("odom", "map")], []),
    "two parents": (
        [("map", "base"), ("odom", "base")],
        ["TF gives base 2 parents (map, odom): a frame can have only one"],
    ),
    "loop": ([("a", "b"), ("b", "c"), ("c", "a"), ("c", "d")], ["TF has a loop: a -> b -> c -> a"]),
    "to and fro": ([("odom", "base"), ("base", "odom")], ["TF has a loop: base -> odom -> base"]),
    "itself": ([("odom", "odom")], ["TF has a loop: odom -> odom"]),
}


@pytest.mark.parametrize("name", TREES)
def test_trees_of_frames_that_are_none_are_said(name):
    edges, said = TREES[name]
    assert frame_faults(edges, "odom", "base") == said


def test_a_long_chain_and_many_parents_take_no_time():
    chain = [(f"f{k}", f"f{k + 1}") for k in range(3000)]
    assert frame_faults(chain, None, None) == []
    web = [(f"f{k}", f"f{j}") for k in range(40) for j in range(k + 1, 40)]
    assert len(frame_faults(web, None, None)) == 38


@pytest.fixture
def odd(tmp_path):
    """Write a drive with a pose of no orientation, one upright, one far away, and a loop of frames."""
    t, poses = office(20.0, 20.0)
    poses = poses.copy()
    poses[50, 0] = 1e15
    drive = [(ODOM, stamp, odometry(stamp, pose)) for stamp, pose in zip(t, poses, strict=True)]
    for row, quat in ((60, np.zeros(4)), (70, quaternion(0.3, 0.0, np.pi / 2))):
        was, now = (one.astype("<f8").tobytes() for one in (quaternion(poses[row, 2]), quat))
        drive[row] = (*drive[row][:2], drive[row][2].replace(was, now))
    edges = (("odom", "base_link"), ("map", "base_link"), ("base_link", "laser"), ("laser", "map"))
    tree = [(TF, stamp, transforms((stamp, *edge, np.zeros(3)))) for stamp in t[:3] for edge in edges]
    return write_mcap(tmp_path / "in.mcap", drive + tree)


SAID = (
    "1 orientations are quaternions of four zeros: not used, and left unchanged",
    "1 poses pitch beyond 85 deg: their heading is that of the z axis",
    "1 poses are beyond 1e+09 m: not used, and left unchanged",
    "TF gives base_link 2 parents (map, odom): a frame can have only one",
    "TF has a loop: base_link -> laser -> map -> base_link",
)


def test_info_and_the_summary_say_them(odd, tmp_path, capsys):
    assert run(["info", str(odd), "-v"]) == 0
    seen = capsys.readouterr().out
    assert run([str(odd), str(tmp_path / "out.mcap"), "-v", *NOISE]) == 0
    moved = capsys.readouterr().err
    for sentence in SAID:
        assert sentence in seen, seen
        assert f"{sentence[0].upper()}{sentence[1:]}." in moved, moved
    assert "are not numbers" not in moved + seen


def test_one_frame_for_odom_and_base_is_said(tmp_path, capsys):
    words = ["--base-frame", "odom", "-v"]
    assert run(["info", str(FIXTURES / "office.mcap"), *words]) == 0
    assert run([str(FIXTURES / "office.mcap"), str(tmp_path / "out.mcap"), *words, *NOISE]) == 0
    said = capsys.readouterr()
    assert "the odometry is from odom to odom, one and the same frame" in said.out
    assert "The odometry is from odom to odom, one and the same frame" in said.err


def test_a_log_time_before_1970_is_no_time_of_an_mcap(tmp_path, capsys):
    path = tmp_path / "in.db3"
    path.write_bytes((FIXTURES / "office_ros2" / "office_ros2.db3").read_bytes())
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE messages SET timestamp = -5 WHERE rowid = 3")
    assert run([str(path), str(tmp_path / "out.mcap"), *NOISE]) == 1
    assert "log time -5 ns: is before 1970" in capsys.readouterr().err
    assert not (tmp_path / "out.mcap").exists()
    assert run([str(path), str(tmp_path / "out.db3"), *NOISE]) == 0


def test_quaternions_in_the_order_w_x_y_z_are_said_and_a_constant_roll_is_not():
    yaw = np.linspace(0.0, 6.0, 200)
    place = np.column_stack((np.cos(yaw), np.sin(yaw), 0 * yaw))
    first, upside_down = PoseFaults(), PoseFaults()
    first.take(place, np.array([np.roll(quaternion(a), 1) for a in yaw]))
    upside_down.take(place, np.array([quaternion(a, np.pi) for a in yaw]))
    assert ["w, x, y, z" in said for said in first.sentences()] == [True]
    assert upside_down.sentences() == []


def test_poses_that_stand_still_or_leap_while_twists_move_are_said():
    stamps, twist = np.arange(200) * 10**8, np.tile([0.5, 0.0, 0.1], (200, 1))
    still, millimetres = PoseFaults(), PoseFaults()
    still.twists.take(stamps, np.zeros((200, 3)), twist)
    millimetres.twists.take(stamps, np.column_stack((stamps * 5e-7, stamps * 0, stamps * 1e-10)), twist)
    assert ["odomcorrupt integrate" in said for said in still.sentences()] == [True]
    assert ["millimetres for metres" in said for said in millimetres.sentences()] == [True]

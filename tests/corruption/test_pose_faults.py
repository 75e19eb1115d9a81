"""Oddities of poses, stamps and their order are reported and treated as the report says."""

import sqlite3
from contextlib import closing
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from bagged import ODOM, TF, odometry, quaternion, rows_of, transforms, write_mcap
from drives import office

from odomcorrupt.cli import run
from odomcorrupt.corruption.pose_faults import PoseFaults, frame_faults
from odomcorrupt.corruption.reorder import Arrivals, TimeOrder

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


SECOND_NS = 10**9
ODDITIES = {
    "corrupt": (
        "/tf_static holds odom -> base_link: published once for all time, it cannot follow the drift.",
        "1 odometry stamps are zero: log times were used instead.",
        "1 odometry messages were out of order: they were sorted.",
        "Time jumped back 1 times: each time the drift began again at zero.",
        "The pose jumped 1 times: the correction was held across.",
        "1 odometry stamps lie far ahead of their neighbours': no noise of their own.",
        "2 odometry poses are not numbers: left unchanged.",
    ),
    "correct": (
        "/tf_static holds odom -> base_link: published once for all time, it cannot follow the correction.",
        "Time jumped back 1 times: each stretch was corrected by itself.",
        "The pose jumped 1 times: the correction was held across.",
        "1 odometry stamps lie far ahead of their neighbours': not used to correct.",
        "2 odometry poses are not numbers: left unchanged.",
    ),
}


@pytest.fixture(scope="module")
def strange(tmp_path_factory):
    """Write a drive that jumps, swaps two messages, has a stamp of zero, one of the future, and starts again."""
    t, poses = office(20.0, 20.0)
    poses = poses.copy()
    poses[200:, 0] += 40.0
    poses[50:52, 1] = np.nan, np.inf
    stamps = t.copy()
    stamps[120] += 3600 * SECOND_NS
    stamps[90] = 0
    drive = [(ODOM, log, odometry(s, p)) for log, s, p in zip(t, stamps, poses, strict=True)]
    drive[20], drive[21] = drive[21], drive[20]
    again = [
        (ODOM, log + 30 * SECOND_NS, odometry(s, p))
        for (_, log, _), s, p in zip(drive, *office(20.0, 20.0), strict=True)
    ]
    static = replace(TF, topic="/tf_static")
    edge = (static, t[0], transforms((t[0], "odom", "base_link", np.zeros(3))))
    return write_mcap(tmp_path_factory.mktemp("strange") / "in.mcap", [edge, *drive, *again])


@pytest.mark.parametrize("command", ODDITIES)
def test_oddities_are_counted_and_told(command, strange, tmp_path, capsys):
    out = tmp_path / "out.mcap"
    words = (
        [str(strange), str(out), *NOISE]
        if command == "corrupt"
        else ["correct", str(strange), str(out), "--effect", "unequal_wheels:curvature=0.01"]
    )
    assert run([*words, "-v"]) == 0
    said = capsys.readouterr().err
    for sentence in ODDITIES[command]:
        assert sentence in said, said
    before, after = (rows_of(path).position for path in (strange, out))
    assert before.shape == after.shape
    # all of a pose is left alone, not only the coordinate that is no number
    left = ~np.isfinite(before).all(axis=1)
    assert np.array_equal(~np.isfinite(after).all(axis=1), left)
    assert np.count_nonzero(left) == 2
    assert np.abs(after[~left] - before[~left]).max() < 20.0
    assert np.array_equal(after[left], before[left], equal_nan=True)


def test_a_batch_makes_the_same_bytes_of_them(strange, tmp_path, capsys):
    assert run([str(strange), str(tmp_path / "one.mcap"), *NOISE, "--run", "1"]) == 0
    assert run(["batch", str(strange), str(tmp_path / "runs"), "--runs", "2", *NOISE]) == 0
    assert (tmp_path / "runs" / "run_000001.mcap").read_bytes() == (tmp_path / "one.mcap").read_bytes()


@pytest.mark.parametrize(
    ("topic", "kept", "warned"),
    [("/sim/ground_truth/odom", (), True),
    ("/odom", (), False),
    ("/sim/ground_truth/odom", ("--keep-truth", "/clean"), False)],
)  # fmt: skip
def test_odometry_named_like_a_truth_is_reported_unless_a_clean_copy_is_kept(tmp_path, capsys, topic, kept, warned):
    channel = replace(ODOM, topic=topic)
    write_mcap(
        tmp_path / "in.mcap", [(channel, log, odometry(log, p)) for log, p in zip(*office(20.0, 20.0), strict=True)]
    )
    assert run([str(tmp_path / "in.mcap"), str(tmp_path / "out.mcap"), *NOISE, *kept]) == 0
    assert (f"{topic} is named like a ground truth" in " ".join(capsys.readouterr().err.split())) == warned


S = 10**9


def arrivals(stamps_s, times_s):
    stamps = np.round(np.array(stamps_s) * S).astype(np.int64)
    return Arrivals(stamps, np.round(np.array(times_s) * S).astype(np.int64), np.column_stack([stamps / S] * 3))


def stretches_of(new, cuts):
    """Feed messages in pieces; return the stretches, each as sorted stamps in seconds."""
    order, stretches = TimeOrder(), [[]]
    edges = [0, *cuts, len(new)]
    for start, stop in pairwise(edges):
        piece = new.take(slice(start, stop))
        for ended in order.add(piece):
            stretches[-1].append(ended)
            stretches.append([])
        if len(piece):
            stretches[-1].append(order.release(int(piece.time_ns[-1])))
    stretches[-1].append(order.flush())
    return [np.concatenate([part.stamps_ns for part in parts]) / S for parts in stretches], order


def test_nothing_is_released_that_a_later_message_may_precede():
    order = TimeOrder()
    order.add(arrivals([0.0, 0.4, 0.9], [0.0, 0.4, 0.9]))
    assert len(order.release(round(0.99 * S))) == 0
    order.add(arrivals([1.5], [1.5]))
    assert order.release(round(1.5 * S)).stamps_ns.tolist() == [0, 4 * S // 10]
    assert order.release(round(1.95 * S)).stamps_ns.tolist() == [9 * S // 10]


@pytest.mark.parametrize("seed", range(6))
def test_cuts_do_not_change_what_is_decided(seed):
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.exponential(0.1, 300))
    stamps = times - rng.choice([0.0, 0.0, 0.3, 0.9, 1.4, 40.0], 300, p=[0.4, 0.4, 0.1, 0.05, 0.045, 0.005])
    new = arrivals(stamps, times)
    whole, order = stretches_of(new, [])
    for _ in range(5):
        cuts = np.sort(rng.choice(299, 40, replace=False) + 1)
        pieces, again = stretches_of(new, cuts.tolist())
        assert len(pieces) == len(whole)
        assert all(np.array_equal(a, b) for a, b in zip(pieces, whole, strict=True))
        assert (again.late, again.restarts) == (order.late, order.restarts)


@pytest.mark.parametrize("cuts", [[], [20], [21], [20, 21], [5, 19, 20, 21, 22, 40]])
def test_one_stamp_far_in_the_future_is_left_out_and_time_goes_on(cuts):
    t = np.arange(50) / 10
    stamps = t.copy()
    stamps[20] += 1e6
    stamps[[30, 31]] = stamps[[31, 30]]
    (out,), order = stretches_of(arrivals(stamps, t), cuts)
    assert np.array_equal(out, np.delete(t, 20))
    assert (order.late, order.leaps, order.restarts) == (0, 1, 0)


@pytest.mark.parametrize("cuts", [[], [21], [20, 21]])
def test_a_leap_that_nothing_follows_for_a_second_is_accepted(cuts):
    t = np.concatenate((np.arange(21) / 10, np.arange(35, 50) / 10))
    stamps = t.copy()
    stamps[20] += 50.0
    stretches, order = stretches_of(arrivals(stamps, t), cuts)
    assert [len(s) for s in stretches] == [21, 15]
    assert (order.leaps, order.restarts) == (0, 1)

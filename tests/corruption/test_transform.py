"""Blocks in, blocks out: what moves and stays, cuts that do not matter, oddities that are reported and treated so."""

import sqlite3
from contextlib import closing
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from bagged import (
    IMU,
    ODOM,
    OTHER,
    TF,
    TRUTH,
    MemoryBag,
    blocks_of,
    driven,
    messages_of,
    odometry,
    planar,
    quaternion,
    read,
    robot,
    rows_of,
    transforms,
    twists,
    write_mcap,
)
from drives import model, office, silent

from odomcorrupt.bags.block import Channel
from odomcorrupt.cli import run
from odomcorrupt.corruption.covariance import pose_covariance
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.corruption.pose_faults import PoseFaults, frame_faults
from odomcorrupt.corruption.reorder import Arrivals, TimeOrder
from odomcorrupt.corruption.transform import Options, Transform
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import TopicError
from odomcorrupt.geometry.se2 import Increments, accumulate, between, compose, inverse, wrap
from recordings import FIXTURES

EFFECTS = (effect_from_values("unequal_wheels", {"curvature": 0.02}), effect_from_values("gyro_bias", {"bias": 0.01}))
CHANNELS = {c.id: c for c in (ODOM, TF, IMU)}
MORE = CHANNELS | {OTHER.id: OTHER, TRUTH.id: TRUTH}
DRIVE = office(20.0, 15.0)


def transformed(messages, chosen=None, size=40, *, channels=None, seed=1, complete=True, **options):
    transform = Transform(model() if chosen is None else chosen, seed, 0, Options(**options))
    bag = MemoryBag(blocks_of(messages, size), CHANNELS if channels is None else channels, complete)
    return list(transform.blocks(bag, "test.mcap")), transform


def poses_of(blocks, channel=ODOM, edge=None):
    return read(blocks, channel, "position", edge)[0], planar(blocks, channel, edge)


def by_time(messages):
    return sorted(messages, key=lambda message: message[1])


def assert_same_poses(ours, theirs, tolerance=1e-9):
    off = ours - theirs
    assert np.abs(off[:, :2]).max() < tolerance
    assert np.abs(wrap(off[:, 2])).max() < tolerance


def test_odometry_and_its_covariances_follow_the_noisy_path_of_its_seed():
    out, transform = transformed(robot(*DRIVE))
    samples = NoisyPath(model(), 1).feed(*DRIVE)
    stamps, noisy = poses_of(out)
    assert np.array_equal(stamps, DRIVE[0])
    assert_same_poses(noisy, samples.clean_xyt + samples.error_xyt)
    values = read(out, ODOM, "pose_covariance")[1].reshape(-1, 6, 6)[:, [0, 1, 5]][:, :, [0, 1, 5]]
    expected = pose_covariance(samples.sums, (noisy[:, :2] - samples.origin_xy).T)
    assert values == pytest.approx(expected, rel=1e-9, abs=1e-15)
    assert transform.changes.odometry == {"/odom": 301}
    assert transform.changes.edges == {"odom -> base_link": 301}


@pytest.mark.parametrize(
    "chosen", [model(), model("linear", step="0.25m,0.2rad", effects=EFFECTS), model(effects=EFFECTS)]
)
def test_bytes_do_not_depend_on_where_blocks_end(chosen):
    t, poses = (column[:180] for column in DRIVE)
    slow = [(OTHER, int(s) + 40_000_000, odometry(s - 20_000_000, (1.0, 2.0, 0.3), child="b")) for s in t[3::5]]
    rng = np.random.default_rng(3)
    messages = robot(t, poses)
    messages = by_time(messages + slow)
    for i in rng.choice(len(messages) - 12, 30, replace=False):
        messages[i], messages[i + 9] = messages[i + 9], messages[i]
    whole = messages_of(transformed(messages, chosen, len(messages), channels=MORE, odom_topic="/odom")[0])
    for seed in range(3):
        rng = np.random.default_rng(seed)
        sizes = rng.integers(1, (3, 60, 400)[seed], 2000)
        sizes = sizes[: np.searchsorted(np.cumsum(sizes), len(messages)) + 1]
        assert messages_of(transformed(messages, chosen, sizes, channels=MORE, odom_topic="/odom")[0]) == whole


def test_odometry_and_transform_may_come_in_either_order():
    messages = robot(*DRIVE)
    early = by_time([(c, log - 30_000_000 if c is TF else log, data) for c, log, data in messages])
    edge = ("odom", "base_link")
    assert_same_poses(
        poses_of(transformed(early)[0], TF, edge)[1], poses_of(transformed(messages)[0], TF, edge)[1], 1e-12
    )


def test_an_edge_that_is_turned_round_is_corrected_from_the_right():
    t, poses = DRIVE
    messages = driven(t, poses, ("/base_link", "/odom", inverse), ("/map", "/odom", (1.0, 0.0, 0.0)))
    out, transform = transformed(messages)
    _, back = poses_of(out, TF, ("/base_link", "/odom"))
    assert_same_poses(inverse(back), poses_of(out)[1])
    assert np.array_equal(poses_of(out, TF, ("/map", "/odom"))[1], np.tile([1.0, 0.0, 0.0], (len(t), 1)))
    assert transform.changes.edges == {"base_link -> odom": len(t)}


def test_leading_slashes_are_the_same_frame_and_every_child_of_odom_moves():
    t, poses = DRIVE
    edges = (("odom", "base", np.asarray), ("/odom", "camera_start", (1.0, 2.0, 0.0)), ("odom", "map", np.asarray))
    messages = driven(t, poses, *edges, frame="/odom")
    out, _ = transformed(messages)
    C = compose(poses_of(out)[1], inverse(poses))
    assert_same_poses(poses_of(out, TF, ("/odom", "camera_start"))[1], compose(C, np.array([1.0, 2.0, 0.0])))
    assert np.array_equal(poses_of(out, TF, ("odom", "map"))[1], poses_of(blocks_of(messages), TF, ("odom", "map"))[1])


def integrated(stamps, first_xyt, twist):
    dt = np.diff(stamps)[:, None] * 1e-9
    return accumulate(first_xyt, Increments(*np.ascontiguousarray((twist[1:, [0, 1, 5]] * dt).T)))


@pytest.mark.parametrize("chosen", [model(), model("linear", effects=EFFECTS), silent(EFFECTS)])
def test_twists_integrate_to_the_noisy_path(chosen):
    out, _ = transformed(robot(*DRIVE), chosen)
    stamps, noisy = poses_of(out)
    _, twist = read(out, ODOM, "twist")
    assert not twist[0].any()
    assert_same_poses(integrated(stamps, noisy[0], twist), noisy, 1e-9)


def test_twists_of_another_topic_in_the_same_frame_integrate_too():
    t, poses = DRIVE
    rows = np.arange(1, len(t), 7)
    own = compose(np.array([3.0, -2.0, 0.5]), poses)[rows]
    slow = [
        (OTHER, int(s) + 9_000_000, odometry(s, p, w))
        for s, p, w in zip(t[rows], own, twists(t[rows], own), strict=True)
    ]
    out, _ = transformed(by_time(robot(t, poses) + slow), channels=MORE, odom_topic="/odom")
    stamps, noisy = poses_of(out, OTHER)
    _, twist = read(out, OTHER, "twist")
    assert_same_poses(integrated(stamps, noisy[0], twist), noisy, 1e-9)
    C = compose(poses_of(out)[1], inverse(poses))[rows]
    assert_same_poses(noisy, compose(C, own))


def test_odometry_in_another_frame_stays():
    messages = robot(*DRIVE)
    messages += [(TRUTH, int(s), odometry(s, p, frame="map")) for s, p in zip(*DRIVE, strict=True)]
    out, _ = transformed(by_time(messages), channels=MORE, odom_topic="/odom")
    assert np.array_equal(poses_of(out, TRUTH)[1], poses_of(blocks_of(messages), TRUTH)[1])


@pytest.mark.slow
def test_twist_covariance_says_how_much_noise_the_twists_carry():
    t, poses = DRIVE
    clean = read(blocks_of(robot(t, poses)), ODOM, "twist")[1][:, [0, 1, 5]]
    nees = []
    for seed in range(40):
        out, _ = transformed(robot(t, poses), model("linear"), seed=seed)
        error = read(out, ODOM, "twist")[1][:, [0, 1, 5]] - clean
        P = read(out, ODOM, "twist_covariance")[1].reshape(-1, 6, 6)[:, [0, 1, 5]][:, :, [0, 1, 5]]
        e, P = error[1:150], P[1:150]
        nees.append(np.einsum("ni,ni->n", e[:, [0, 2]], np.linalg.solve(P[:, ::2, ::2], e[:, [0, 2], None])[..., 0]))
    assert np.mean(nees) / 2 == pytest.approx(1.0, abs=0.05)


COVARIANCES = ("pose_covariance", "twist_covariance")


@pytest.mark.parametrize(
    ("chosen", "options", "names"), [(silent(EFFECTS), {}, COVARIANCES),
    (model(), {"keep_covariance": True}, COVARIANCES), (model(), {"keep_twist": True}, ("twist",))]
)  # fmt: skip
def test_twists_and_covariances_stay_on_request_and_covariances_where_no_noise_is_drawn(chosen, options, names):
    before = blocks_of(robot(*DRIVE))
    out, _ = transformed(robot(*DRIVE), chosen, **options)
    assert not np.array_equal(poses_of(out)[1], poses_of(before)[1])
    for name in names:
        assert np.array_equal(read(out, ODOM, name)[1], read(before, ODOM, name)[1])


def test_time_that_begins_again_begins_a_new_stretch():
    t, poses = DRIVE
    first, again = robot(t, poses), robot(t, poses)
    later = int(t[-1] - t[0]) + 50_000_000
    messages = first + [(c, log + later, data) for c, log, data in again]
    out, transform = transformed(messages)
    _, noisy = poses_of(out)
    n = len(t)
    assert transform.order.restarts == 1
    assert np.array_equal(noisy[n], poses_of(blocks_of(messages))[1][n])
    assert np.abs(noisy[n - 1] - poses[-1]).max() > 0.01
    assert_same_poses(poses_of(out, TF, ("odom", "base_link"))[1], noisy, 1e-12)
    _, twist = read(out, ODOM, "twist")
    assert not twist[n].any()
    assert_same_poses(integrated(t, noisy[n], twist[n:]), noisy[n:], 1e-9)


def test_swapped_messages_get_the_correction_of_their_own_stamp():
    t, poses = DRIVE
    messages = [(ODOM, int(s), odometry(s, p, w)) for s, p, w in zip(t, poses, twists(t, poses), strict=True)]
    swapped = list(messages)
    for i in (50, 120):
        swapped[i], swapped[i + 5] = swapped[i + 5], swapped[i]
    swapped = [(c, log, data) for (c, _, data), (_, log, _) in zip(swapped, messages, strict=True)]
    tidy, (messy, transform) = transformed(messages)[0], transformed(swapped)
    stamps, noisy = poses_of(messy)
    assert transform.order.swapped == 10, "each swap puts five messages behind the one that came too soon"
    assert np.array_equal(noisy[np.argsort(stamps)], poses_of(tidy)[1])


def test_the_correction_is_held_where_odometry_ends_and_that_is_counted():
    t, poses = DRIVE
    messages = driven(t[:200], poses[:200])
    messages += [(TF, int(s) + 1, transforms((s, "odom", "base_link", p))) for s, p in zip(t, poses, strict=True)]
    out, transform = transformed(by_time(messages))
    assert transform.changes.held == len(t) - 200
    C = compose(poses_of(out, TF, ("odom", "base_link"))[1], inverse(poses))
    assert np.ptp(C[199:], axis=0) == pytest.approx(0.0, abs=1e-9)


def watched(bag):
    """Return the blocks that were read from a bag so far, and an iterator over what is made of them."""
    read_blocks = []
    bag.blocks = lambda _only=None: (read_blocks.append(block) or block for block in bag.held)
    return read_blocks, Transform(model(), 1).blocks(bag, "test")


def test_blocks_are_not_held_for_longer_than_two_seconds():
    t, poses = office(20.0, 30.0)
    messages = [(ODOM, int(t[0]), odometry(t[0], poses[0]))]
    messages += [(TF, int(s) + 1, transforms((s, "odom", "base_link", p))) for s, p in zip(t, poses, strict=True)]
    read_blocks, given = watched(MemoryBag(blocks_of(messages, 5)))
    for block in given:
        assert int(read_blocks[-1].table["log_ns"][-1] - block.table["log_ns"][-1]) <= 2_300_000_000


def test_stamps_of_zero_are_read_as_log_times_and_stay_zero():
    t, poses = DRIVE
    stamped = driven(t, poses)
    bare = [(ODOM, int(s), odometry(0, p)) for s, p in zip(t, poses, strict=True)]
    shift = (effect_from_values("time_offset", {"offset": 0.1}),)
    out, transform = transformed(bare, model(effects=shift))
    assert transform.odometry.faults.zero_stamps == len(t)
    assert np.array_equal(poses_of(out)[1], poses_of(transformed(stamped)[0])[1])
    assert not poses_of(out)[0].any()


def test_clock_effects_shift_stamps_of_odometry_and_its_edges_and_nothing_else():
    messages = robot(*DRIVE)
    clocks = (effect_from_values("time_offset", {"offset": 0.03}), effect_from_values("clock_skew", {"rate": 1e-3}))
    out, _ = transformed(messages, silent(clocks))
    t = DRIVE[0]
    late = t + np.rint(0.03e9 + 1e-3 * (t - t[0])).astype(np.int64)
    assert np.abs(poses_of(out)[0] - late).max() <= 1
    assert np.abs(poses_of(out, TF, ("odom", "base_link"))[0] - late).max() <= 1
    assert np.array_equal(poses_of(out, TF, ("map", "odom"))[0], t)
    assert np.array_equal(poses_of(out)[1], poses_of(blocks_of(messages))[1])


@pytest.mark.parametrize(
    ("channels", "options", "sentence"),
    [({IMU.id: IMU}, {}, r"test.mcap: no nav_msgs/Odometry topic \(found /imu\)"),
    ({}, {}, "found no topic at all"), (MORE, {}, r"2 nav_msgs/Odometry topics \(/filtered, /odom\).*odom_topic"),
    (MORE, {"odom_topic": "/odometry"}, "no topic /odometry .nav_msgs/Odometry is on /filtered, /odom, /truth"),
    (MORE, {"odom_topic": "imu"}, "imu is sensor_msgs/msg/Imu in cdr"),
    (CHANNELS | {9: Channel(9, "/odom2", "nav_msgs/msg/Odometry", "json")}, {"odom_topic": "odom2"}, "in json"),
    (CHANNELS, {}, "/odom has no message")]
)  # fmt: skip
def test_what_cannot_drive_the_model_is_said_with_the_way_out(channels, options, sentence):
    with pytest.raises(TopicError, match=sentence):
        transformed([], channels=channels, **options)


def test_a_pipe_needs_to_be_given_the_topic_and_says_so():
    with pytest.raises(TopicError, match=r"on a pipe.*odom_topic"):
        transformed(robot(*DRIVE), complete=False)
    with pytest.raises(TopicError, match="no topic /elsewhere"):
        transformed(robot(*DRIVE), complete=False, odom_topic="/elsewhere")


@pytest.mark.parametrize("frame", ["map", "", "/world", "robot1/map"])
def test_odometry_outside_an_odom_frame_needs_the_frame_named(frame):
    messages = driven(*DRIVE, ("odom", "base_link", np.asarray), frame=frame)
    with pytest.raises(TopicError, match="odom_frame"):
        transformed(messages)
    out, _ = transformed(messages, odom_frame="odom")
    assert_same_poses(poses_of(out, TF, ("odom", "base_link"))[1], poses_of(out)[1], 1e-12)


def test_the_base_frame_can_be_named_for_edges_turned_round():
    messages = driven(*DRIVE, ("base_footprint", "odom", inverse))
    out, _ = transformed(messages, base_frame="base_footprint")
    assert_same_poses(inverse(poses_of(out, TF, ("base_footprint", "odom"))[1]), poses_of(out)[1])
    assert transformed(messages)[1].changes.edges == {}


def test_drift_expected_and_drawn_agree_over_many_runs():
    drive = office(10.0, 60.0)
    messages = driven(*drive)
    drifts = [transformed(messages, size=1000, seed=seed)[1].drift.result() for seed in range(60)]
    assert drifts[0].rate_hz == pytest.approx(10.0)
    assert drifts[0].distance_m == pytest.approx(NoisyPath(silent(), 1).feed(*drive).travelled_m[-1])
    for drawn, expected in (("leg_drawn_m", "leg_expected_m"), ("leg_drawn_rad", "leg_expected_rad")):
        ours = np.sqrt(np.mean([getattr(d, drawn) ** 2 for d in drifts]))
        assert ours == pytest.approx(np.mean([getattr(d, expected) for d in drifts]), rel=0.15)
    end = np.sqrt(np.mean([d.end_drawn_rad**2 for d in drifts]))
    assert end == pytest.approx(drifts[0].end_expected_rad, rel=0.25)


def test_relative_poses_on_the_way_do_not_depend_on_where_odom_began():
    """The noisy path of a drive seen from its own start is the same wherever the odom frame lies."""
    t, poses = DRIVE
    moved = compose(np.array([120.0, -40.0, 1.0]), between(poses[:1], poses))
    ours = poses_of(transformed(driven(t, poses))[0])[1]
    theirs = poses_of(transformed(driven(t, moved))[0])[1]
    assert_same_poses(between(ours[:1], ours), between(theirs[:1], theirs), 1e-8)


def test_a_log_clock_that_stands_still_does_not_hold_the_whole_bag():
    messages = [(channel, 10**18, data) for channel, _, data in robot(*office(20.0, 40.0))]
    read_blocks, given = watched(MemoryBag(blocks_of(messages, 30), CHANNELS))
    held = max(len(read_blocks) - i for i, _ in enumerate(given))
    assert held < 20


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


def test_info_and_the_summary_say_them(odd, tmp_path, invoke):
    seen = invoke(["info", odd, "-v"]).out
    moved = invoke([odd, tmp_path / "out.mcap", "-v", *NOISE]).err
    for sentence in SAID:
        assert sentence in seen, seen
        assert f"{sentence[0].upper()}{sentence[1:]}." in moved, moved
    assert "are not numbers" not in moved + seen


def test_one_frame_for_odom_and_base_is_said(tmp_path, invoke):
    words = ["--base-frame", "odom", "-v"]
    office, same = FIXTURES / "office.mcap", "he odometry is from odom to odom, one and the same frame"
    assert f"t{same}" in invoke(["info", office, *words]).out
    assert f"T{same}" in invoke([office, tmp_path / "out.mcap", *words, *NOISE]).err


def test_a_log_time_before_1970_is_no_time_of_an_mcap(tmp_path, invoke):
    path = tmp_path / "in.db3"
    path.write_bytes((FIXTURES / "office_ros2" / "office_ros2.db3").read_bytes())
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE messages SET timestamp = -5 WHERE rowid = 3")
    assert "log time -5 ns: is before 1970" in invoke([path, tmp_path / "out.mcap", *NOISE], 1).err
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
def test_oddities_are_counted_and_told(command, strange, tmp_path, invoke):
    out = tmp_path / "out.mcap"
    words = (
        [str(strange), str(out), *NOISE]
        if command == "corrupt"
        else ["correct", str(strange), str(out), "--effect", "unequal_wheels:curvature=0.01"]
    )
    said = invoke([*words, "-v"]).err
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

"""Blocks in, blocks out: what moves, what stays, and that cuts do not matter."""

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
    read,
    robot,
    transforms,
    twists,
)
from drives import model, office, silent

from odomcorrupt.bags.block import Channel
from odomcorrupt.corruption.covariance import pose_covariance
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.corruption.transform import Options, Transform
from odomcorrupt.effects import effect_from_values
from odomcorrupt.errors import TopicError
from odomcorrupt.geometry.se2 import Increments, accumulate, between, compose, inverse, wrap

EFFECTS = (effect_from_values("unequal_wheels", {"curvature": 0.02}), effect_from_values("gyro_bias", {"bias": 0.01}))
CHANNELS = {c.id: c for c in (ODOM, TF, IMU)}
MORE = CHANNELS | {OTHER.id: OTHER, TRUTH.id: TRUTH}
DRIVE = office(20.0, 15.0)


def run(messages, chosen=None, size=40, *, channels=None, seed=1, complete=True, **options):
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
    out, transform = run(robot(*DRIVE))
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
    whole = messages_of(run(messages, chosen, len(messages), channels=MORE, odom_topic="/odom")[0])
    for seed in range(3):
        rng = np.random.default_rng(seed)
        sizes = rng.integers(1, (3, 60, 400)[seed], 2000)
        sizes = sizes[: np.searchsorted(np.cumsum(sizes), len(messages)) + 1]
        assert messages_of(run(messages, chosen, sizes, channels=MORE, odom_topic="/odom")[0]) == whole


def test_odometry_and_transform_may_come_in_either_order():
    messages = robot(*DRIVE)
    early = by_time([(c, log - 30_000_000 if c is TF else log, data) for c, log, data in messages])
    edge = ("odom", "base_link")
    assert_same_poses(poses_of(run(early)[0], TF, edge)[1], poses_of(run(messages)[0], TF, edge)[1], 1e-12)


def test_an_edge_that_is_turned_round_is_corrected_from_the_right():
    t, poses = DRIVE
    messages = driven(t, poses, ("/base_link", "/odom", inverse), ("/map", "/odom", (1.0, 0.0, 0.0)))
    out, transform = run(messages)
    _, back = poses_of(out, TF, ("/base_link", "/odom"))
    assert_same_poses(inverse(back), poses_of(out)[1])
    assert np.array_equal(poses_of(out, TF, ("/map", "/odom"))[1], np.tile([1.0, 0.0, 0.0], (len(t), 1)))
    assert transform.changes.edges == {"base_link -> odom": len(t)}


def test_leading_slashes_are_the_same_frame_and_every_child_of_odom_moves():
    t, poses = DRIVE
    edges = (("odom", "base", np.asarray), ("/odom", "camera_start", (1.0, 2.0, 0.0)), ("odom", "map", np.asarray))
    messages = driven(t, poses, *edges, frame="/odom")
    out, _ = run(messages)
    C = compose(poses_of(out)[1], inverse(poses))
    assert_same_poses(poses_of(out, TF, ("/odom", "camera_start"))[1], compose(C, np.array([1.0, 2.0, 0.0])))
    assert np.array_equal(poses_of(out, TF, ("odom", "map"))[1], poses_of(blocks_of(messages), TF, ("odom", "map"))[1])


def integrated(stamps, first_xyt, twist):
    dt = np.diff(stamps)[:, None] * 1e-9
    return accumulate(first_xyt, Increments(*np.ascontiguousarray((twist[1:, [0, 1, 5]] * dt).T)))


@pytest.mark.parametrize("chosen", [model(), model("linear", effects=EFFECTS), silent(EFFECTS)])
def test_twists_integrate_to_the_noisy_path(chosen):
    out, _ = run(robot(*DRIVE), chosen)
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
    out, _ = run(by_time(robot(t, poses) + slow), channels=MORE, odom_topic="/odom")
    stamps, noisy = poses_of(out, OTHER)
    _, twist = read(out, OTHER, "twist")
    assert_same_poses(integrated(stamps, noisy[0], twist), noisy, 1e-9)
    C = compose(poses_of(out)[1], inverse(poses))[rows]
    assert_same_poses(noisy, compose(C, own))


def test_odometry_in_another_frame_stays():
    messages = robot(*DRIVE)
    messages += [(TRUTH, int(s), odometry(s, p, frame="map")) for s, p in zip(*DRIVE, strict=True)]
    out, _ = run(by_time(messages), channels=MORE, odom_topic="/odom")
    assert np.array_equal(poses_of(out, TRUTH)[1], poses_of(blocks_of(messages), TRUTH)[1])


@pytest.mark.slow
def test_twist_covariance_says_how_much_noise_the_twists_carry():
    t, poses = DRIVE
    clean = read(blocks_of(robot(t, poses)), ODOM, "twist")[1][:, [0, 1, 5]]
    nees = []
    for seed in range(40):
        out, _ = run(robot(t, poses), model("linear"), seed=seed)
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
    out, _ = run(robot(*DRIVE), chosen, **options)
    assert not np.array_equal(poses_of(out)[1], poses_of(before)[1])
    for name in names:
        assert np.array_equal(read(out, ODOM, name)[1], read(before, ODOM, name)[1])


def test_time_that_begins_again_begins_a_new_stretch():
    t, poses = DRIVE
    first, again = robot(t, poses), robot(t, poses)
    later = int(t[-1] - t[0]) + 50_000_000
    messages = first + [(c, log + later, data) for c, log, data in again]
    out, transform = run(messages)
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
    tidy, (messy, transform) = run(messages)[0], run(swapped)
    stamps, noisy = poses_of(messy)
    assert transform.order.swapped == 10, "each swap puts five messages behind the one that came too soon"
    assert np.array_equal(noisy[np.argsort(stamps)], poses_of(tidy)[1])


def test_the_correction_is_held_where_odometry_ends_and_that_is_counted():
    t, poses = DRIVE
    messages = driven(t[:200], poses[:200])
    messages += [(TF, int(s) + 1, transforms((s, "odom", "base_link", p))) for s, p in zip(t, poses, strict=True)]
    out, transform = run(by_time(messages))
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
    out, transform = run(bare, model(effects=shift))
    assert transform.odometry.faults.zero_stamps == len(t)
    assert np.array_equal(poses_of(out)[1], poses_of(run(stamped)[0])[1])
    assert not poses_of(out)[0].any()


def test_clock_effects_shift_stamps_of_odometry_and_its_edges_and_nothing_else():
    messages = robot(*DRIVE)
    clocks = (effect_from_values("time_offset", {"offset": 0.03}), effect_from_values("clock_skew", {"rate": 1e-3}))
    out, _ = run(messages, silent(clocks))
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
        run([], channels=channels, **options)


def test_a_pipe_needs_to_be_given_the_topic_and_says_so():
    with pytest.raises(TopicError, match=r"on a pipe.*odom_topic"):
        run(robot(*DRIVE), complete=False)
    with pytest.raises(TopicError, match="no topic /elsewhere"):
        run(robot(*DRIVE), complete=False, odom_topic="/elsewhere")


@pytest.mark.parametrize("frame", ["map", "", "/world", "robot1/map"])
def test_odometry_outside_an_odom_frame_needs_the_frame_named(frame):
    messages = driven(*DRIVE, ("odom", "base_link", np.asarray), frame=frame)
    with pytest.raises(TopicError, match="odom_frame"):
        run(messages)
    out, _ = run(messages, odom_frame="odom")
    assert_same_poses(poses_of(out, TF, ("odom", "base_link"))[1], poses_of(out)[1], 1e-12)


def test_the_base_frame_can_be_named_for_edges_turned_round():
    messages = driven(*DRIVE, ("base_footprint", "odom", inverse))
    out, _ = run(messages, base_frame="base_footprint")
    assert_same_poses(inverse(poses_of(out, TF, ("base_footprint", "odom"))[1]), poses_of(out)[1])
    assert run(messages)[1].changes.edges == {}


def test_drift_expected_and_drawn_agree_over_many_runs():
    drive = office(10.0, 60.0)
    messages = driven(*drive)
    drifts = [run(messages, size=1000, seed=seed)[1].drift.result() for seed in range(60)]
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
    ours = poses_of(run(driven(t, poses))[0])[1]
    theirs = poses_of(run(driven(t, moved))[0])[1]
    assert_same_poses(between(ours[:1], ours), between(theirs[:1], theirs), 1e-8)


def test_a_log_clock_that_stands_still_does_not_hold_the_whole_bag():
    messages = [(channel, 10**18, data) for channel, _, data in robot(*office(20.0, 40.0))]
    read_blocks, given = watched(MemoryBag(blocks_of(messages, 30), CHANNELS))
    held = max(len(read_blocks) - i for i, _ in enumerate(given))
    assert held < 20

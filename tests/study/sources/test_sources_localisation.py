"""Of a localisation based on the odometry, only the corrections are used as truth, over TF or as poses from TF."""

import numpy as np
import pytest
from sourcebags import edges, topic, write
from sourcedrive import START_NS, Rows, odometry, truth

from odomcorrupt.geometry.se2 import compose, inverse
from odomcorrupt.study.io import Source, read_runs

EVERY = 20
"""Samples of the odometry between two corrections."""


def drive(seconds=30.0):
    """Return odometry, where the robot really was at its samples (n, 3), and the correction map -> odom of each."""
    moved, real = odometry(seconds), truth(seconds, noise=0.0)
    own, at = ((rows.stamps_ns - START_NS) * 1e-9 for rows in (real, moved))
    base = np.stack([np.interp(at, own, column) for column in real.xyt.T], axis=1)
    base += 0.003 * np.random.default_rng(5).standard_normal(base.shape)
    said = np.column_stack((moved.xyz[:, :2], moved.yaw))
    return moved, base, compose(base, inverse(said))


def flat(stamps_ns, xyt):
    return Rows(stamps_ns, np.column_stack((xyt[:, :2], 0.0 * xyt[:, 0])), xyt[:, 2])


@pytest.mark.parametrize(
    ("start_ns", "pace", "delay_s", "every"),
    [
        (START_NS, 1.0, 0.0, 4),
        (START_NS, 1.0, 0.02, 4),
        (START_NS, 1.0, 0.0, EVERY),
        (100 * 10**9, 1.0, 0.0, 4),
        (100 * 10**9, 0.4, 0.0, 4),
    ],
    ids=["real time", "late logs", "corrections alone", "simulated time", "a simulation slower than time"],
)
def test_over_tf_corrections_are_taken_when_they_were_sent(tmp_path, start_ns, pace, delay_s, every):
    moved, base, offsets = drive()
    moved = moved.having(stamps_ns=moved.stamps_ns - START_NS + start_ns)
    logs = START_NS + ((moved.stamps_ns - start_ns) / pace + delay_s * 1e9).astype(np.int64)
    corrected, sent = np.arange(0, len(base), EVERY), np.arange(0, len(base), every)
    last = corrected[np.searchsorted(corrected, sent, side="right") - 1]
    bag = write(
        tmp_path / "run.mcap",
        topic("/odom", "Odometry", moved, log_ns=logs),
        edges(flat(moved.stamps_ns[sent] + 10**9, offsets[last]), "map", "odom", log_ns=logs[sent]),
        edges(moved, "odom", "base_link", log_ns=logs),
    )
    (recording,) = read_runs(Source(bag, truth="/tf:map.base_link"))
    assert any("a localisation on top of the odometry" in note for note in recording.notes)
    assert any("stamps are 1 s later than the times of sending" in note for note in recording.notes)
    # log times are those of the odometry to a few samples of their own resolution
    wanted = np.searchsorted(moved.stamps_ns, recording.truth.stamps_ns + 10**6, side="right") - 1
    assert np.isin(wanted, corrected).all()
    assert len(wanted) > 0.9 * len(corrected)
    np.testing.assert_allclose(recording.truth.xyt[:, :2], base[wanted, :2], atol=1e-3)


@pytest.mark.parametrize("asked", ["of the odometry", "between its samples", "late"])
def test_poses_made_from_tf_are_taken_at_the_corrections_alone(read, asked):
    moved, _, offsets = drive()
    at = moved.stamps_ns if asked == "of the odometry" else moved.stamps_ns[:-1] + 20_000_000
    now = (at - START_NS) * 1e-9
    if asked == "between its samples":
        own = (moved.stamps_ns - START_NS) * 1e-9
        said = np.stack([np.interp(now, own, column) for column in moved.xyt.T], axis=1)
    else:
        said = moved.xyt[: len(at)]
    last = np.arange(len(at)) // EVERY * EVERY
    (recording,) = read(moved, flat(at, compose(offsets[last], said)), truth="/robot_pose")
    assert any("/robot_pose: a localisation on top of /odom; the truth is taken at its" in n for n in recording.notes)
    assert np.array_equal(recording.truth.stamps_ns, at[::EVERY])


def test_a_truth_of_its_own_is_left_as_it_is(read):
    moved, base, _ = drive()
    (recording,) = read(moved, flat(moved.stamps_ns, base), truth="/pose")
    assert len(recording.truth) == len(base)


@pytest.mark.parametrize(("name", "every", "localised"), [("/amcl_pose", 20, True), ("/orb_slam/pose", 1, False)])
def test_sparse_poses_of_a_localisation_are_known_by_their_name(read, name, every, localised):
    moved, base, _ = drive()
    (recording,) = read(moved, flat(moved.stamps_ns[::every], base[::every]), truth=name)
    assert recording.localised == localised
    # without a child frame they are of the base itself
    assert recording.of_base == localised
    assert len(recording.truth) == len(base[::every])


@pytest.mark.parametrize(("by_motion", "frame"), [(True, "map"), (True, "world"), (False, "map")])
def test_poses_in_the_map_that_come_after_so_much_motion_are_a_localisations(read, by_motion, frame):
    moved, base, _ = drive(60.0)
    turned = 0.6 * np.abs(np.diff(base[:, 2], prepend=base[0, 2]))
    gone = np.cumsum(np.hypot(*np.diff(base[:, :2], axis=0, prepend=base[:1, :2]).T) + turned)
    rows = np.searchsorted(gone, np.arange(0.0, gone[-1], 0.4)) if by_motion else np.arange(0, len(base), EVERY)
    poses = flat(moved.stamps_ns[rows], base[rows])
    (recording,) = read(moved, poses, truth="/pose", kind="PoseWithCovarianceStamped", seen={"frame": frame})
    assert recording.localised == (by_motion and frame == "map")


@pytest.mark.parametrize(
    ("name", "frame", "correlated_m", "white_m", "localised"),
    [
        ("/robot_pose", "map", 0.015, 5e-4, True),
        ("/robot_pose", "world", 0.015, 5e-4, False),
        ("/vicon/robot", "map", 0.015, 5e-4, False),
        ("/robot_pose", "map", 0.001, 5e-4, False),  # motion capture
        ("/robot_pose", "map", 0.005, 0.012, False),  # an antenna
    ],
)
def test_poses_in_the_map_are_a_localisations_by_their_errors(read, name, frame, correlated_m, white_m, localised):
    moved, real, rng = odometry(120.0), truth(120.0, noise=0.0), np.random.default_rng(8)
    own, at = ((rows.stamps_ns - START_NS) * 1e-9 for rows in (real, moved))
    base = np.stack([np.interp(at, own, column) for column in real.xyt.T], axis=1)[::5]
    kept = np.exp(-np.hypot(*np.diff(base[:, :2], axis=0).T) / 1.5)
    error = [rng.standard_normal(3)]
    for keep in kept:
        error.append(keep * error[-1] + np.sqrt(1.0 - keep**2) * rng.standard_normal(3))
    base[:, :2] += correlated_m * np.array(error)[:, :2] + white_m * rng.standard_normal((len(base), 2))
    (recording,) = read(moved, flat(moved.stamps_ns[::5], base), truth=name, seen={"frame": frame})
    assert recording.localised == localised


@pytest.mark.parametrize(
    ("name", "kind", "frame", "in_map"),
    [
        ("/vslam/odometry", "Odometry", "world", True),
        ("/vicon/robot", "Odometry", "map", False),
        ("/ground_truth", "Odometry", "map", False),
        ("/robot/pose", "PoseStamped", "map", True),
        ("/robot/pose", "PoseStamped", "world", False),
    ],
)
def test_a_truth_is_in_a_map_by_its_name_or_frame(read, name, kind, frame, in_map):
    (run,) = read(truth=name, kind=kind, seen={"frame": frame}, asked={"truth": name, "odom": "/odom"})
    assert run.in_map == in_map


def test_poses_of_a_localisation_at_a_high_rate_are_taken_after_motion(read):
    moved, base, _ = drive()
    stop = np.minimum(np.arange(len(base)), 300)  # the robot stops after 15 s
    moved = flat(moved.stamps_ns, moved.xyt[stop])
    found = base[stop] + 1e-4 * np.random.default_rng(6).standard_normal(base.shape)
    (recording,) = read(moved, flat(moved.stamps_ns, found), truth="/slam_pose", seen={"frame": "map"})
    assert recording.localised
    assert recording.of_base
    own = recording.odometry.at(recording.truth_s, recording.origin_ns)
    step = np.diff(own, axis=0)
    gone, turned = np.hypot(step[:, 0], step[:, 1]), np.abs(step[:, 2])
    assert np.all((gone >= 0.25) | (turned >= 0.2))
    assert np.all((gone < 0.3) & (turned < 0.26))
    assert len(recording.truth) < 80
    assert any(f"{len(recording.truth)} of {len(base)}" in note for note in recording.notes)

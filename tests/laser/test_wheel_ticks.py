"""Wheel angles of JointState: nominal radius and track from them, counts, and the odometry that they sum to."""

import laserbags
import numpy as np
import pytest
from test_gyro import drive, truth_of

from odomcorrupt.cli import run
from odomcorrupt.geometry.se2 import Increments, accumulate, increments
from odomcorrupt.study.io import Source, read_runs
from odomcorrupt.study.io.wheel_ticks import find_joints

RADIUS, TRACK = 0.08, 0.46


def bag(path, *, tick=None, heading_off=0.0, names=("wheel_left_joint", "wheel_right_joint")):
    """A drive whose odometry is the sum of wheel angles, and these."""
    simulated = drive(7, duration_s=80.0, yaw_from="encoders")
    step = increments(simulated.odom_xyt)
    turn = step.dtheta_rad * TRACK / 2.0
    angle = np.cumsum(np.stack((step.ds_m - turn, step.ds_m + turn), axis=1) / RADIUS, axis=0)
    angle = np.concatenate((np.zeros((1, 2)), angle))
    if tick is not None:
        angle = np.floor(angle / tick) * tick
    other = step.dtheta_rad + heading_off * np.sin(np.arange(len(step.ds_m)) / 40.0) * 0.1
    odometry = accumulate(simulated.odom_xyt[0], Increments(step.ds_m, step.dl_m, other))
    return laserbags.write(
        path,
        laserbags.odometry(simulated.odom_stamps_ns, odometry),
        laserbags.joints(simulated.odom_stamps_ns, ("caster", *names), np.column_stack((angle[:, 0] * 0.3, angle))),
        truth_of(simulated),
    )


@pytest.mark.parametrize(
    ("names", "found"),
    [
        (["caster", "left_wheel", "right_wheel"], ("left_wheel", "right_wheel")),
        (["wheel_r_joint", "wheel_l_joint"], ("wheel_l_joint", "wheel_r_joint")),
        (["front_left_wheel", "rear_left_wheel", "front_right_wheel", "rear_right_wheel"], None),
        (["left_arm", "right_arm"], None),
    ],
)
def test_wheels_are_found_by_their_names_where_there_is_one_each(names, found):
    assert find_joints(names) == found


def test_radius_and_track_are_those_that_the_odometry_sums_with(tmp_path):
    (recording,) = read_runs(Source(bag(tmp_path / "run.mcap")))
    assert recording.track_m == pytest.approx(TRACK, rel=2e-3)
    assert any("wheels of 0.08" in note for note in recording.notes)


def test_counts_of_an_encoder_are_seen_and_the_wheels_can_be_the_odometry(tmp_path):
    tick = 2.0 * np.pi / 1024
    path = bag(tmp_path / "run.mcap", tick=tick)
    (recording,) = read_runs(Source(path, joints=("wheel_left_joint", "wheel_right_joint")))
    assert any("1024 a turn" in note for note in recording.notes)
    (own,) = read_runs(Source(path))
    assert recording.odometry.xyt[-1, 2] - recording.odometry.xyt[0, 2] == pytest.approx(
        own.odometry.xyt[-1, 2] - own.odometry.xyt[0, 2], abs=0.02
    )
    assert np.linalg.norm(recording.odometry.xyt[-1, :2] - own.odometry.xyt[-1, :2]) < 0.2


def test_wheels_that_the_odometry_does_not_turn_by_are_no_odometry(tmp_path, capsys):
    path = bag(tmp_path / "run.mcap", heading_off=0.2)
    assert run(["fit", str(path), "--joints", "wheel_left_joint", "wheel_right_joint"]) == 1
    assert "turns are not those of" in capsys.readouterr().err
    assert run(["fit", str(path), "--joints", "wheel_left_joint", "right"]) == 1
    assert "--joints" in capsys.readouterr().err

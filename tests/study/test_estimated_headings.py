"""Headings estimated for a truth of positions only: after outages, and with the model's effects removed."""

from dataclasses import replace

import numpy as np
import pytest

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.io.headings import with_headings
from odomcorrupt.study.io.recording import Recording

AHEAD_M = 0.5  # of the axle, where the antenna is


def drive(ahead_m=0.0, without_s=()):
    """Return a car that weaves, backs up around a corner at 40 s and goes on, with fixes of 5 Hz; and its headings."""
    t_s = np.arange(0.0, 80.0, 0.02)
    speed = np.where(np.abs(t_s - 41.0) < 1.5, -1.0, 1.0)
    turn = 0.5 * np.sin(0.7 * t_s) + np.where(np.abs(t_s - 41.0) < 3.0, -0.6, 0.0)
    yaw = 0.4 + np.cumsum(turn) * 0.02
    x, y = np.cumsum(speed * np.cos(yaw)) * 0.02, np.cumsum(speed * np.sin(yaw)) * 0.02
    stamps = np.round(t_s * 1e9).astype(np.int64)
    fixes = np.arange(5, len(t_s), 10)
    for first, last in without_s:
        fixes = fixes[(t_s[fixes] < first) | (t_s[fixes] > last)]
    xy = np.column_stack((x + ahead_m * np.cos(yaw), y + ahead_m * np.sin(yaw)))[fixes]
    xy += np.random.default_rng(5).normal(0.0, 0.005, xy.shape)
    truth = np.column_stack((xy, np.full(len(xy), np.nan)))
    turned = np.column_stack((x * np.cos(1.1) - y * np.sin(1.1), x * np.sin(1.1) + y * np.cos(1.1), yaw + 1.1))
    recording = Recording(
        name="run", odometry=Trajectory(stamps, turned), truth=Trajectory(stamps[fixes], truth), origin_ns=0,
        track_m=None, notes=(),
    )  # fmt: skip
    return recording, yaw[fixes]


def errors(recording, yaw):
    return (recording.truth.xyt[:, 2] - yaw + np.pi) % (2.0 * np.pi) - np.pi


@pytest.mark.parametrize("without_s", [((0.25, 20.0),), ((30.0, 45.0), (45.4, 60.0))], ids=["first", "between two"])
def test_fixes_that_an_outage_leaves_alone_get_the_heading_of_those_beside_them(without_s):
    recording, yaw = drive(without_s=without_s)
    assert np.abs(errors(with_headings(recording), yaw)).max() < 0.01


def test_a_fast_car_with_few_fixes_has_the_headings_of_its_path():
    recording, yaw = drive()
    truth, odometry = recording.truth, recording.odometry
    few = Trajectory(truth.stamps_ns[::5], truth.xyt[::5] * [8.0, 8.0, 1.0])
    fast = replace(recording, odometry=replace(odometry, xyt=odometry.xyt * [8.0, 8.0, 1.0]), truth=few)
    assert np.abs(errors(with_headings(fast), yaw[::5])).max() < 0.05


def test_headings_are_those_of_the_model_so_that_an_antenna_ahead_of_the_axle_turns_none_of_them():
    recording, yaw = drive(AHEAD_M, without_s=((34.0, 39.5), (42.6, 50.0)))
    plain = with_headings(recording)
    assert np.abs(errors(plain, yaw)).max() > 0.05
    problem = pose_problem([plain], [effect_from_values("lever_arm", {"x": AHEAD_M})], approach=Approach())
    assert np.abs(errors(problem.left[0], yaw)).max() < 0.02
    assert np.abs(problem.intervals.residual[:, :2]).max() < 0.05

"""How noisy a laser's poses are taken to be: jitter of stamps along the path, rests, and axes that are not seen."""

import numpy as np
import pytest

from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.laser.scans import Motion, Sweep, Sweeps, even_stamps
from odomcorrupt.laser.trajectory import (
    UNKNOWN_M,
    LaserPath,
    WhiteNoise,
    white_noise,
    with_noise,
    with_view_errors,
    without_spikes,
)


def straight(seed=0, jitter_s=0.0, noise_m=1e-3):
    """A minute to and fro along a straight line, a rest of 20 s, and what a laser sees of it five times a second."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, 80.0, 0.05)
    x = np.where(t_s < 60.0, 2.0 * np.sin(0.3 * t_s), 2.0 * np.sin(18.0))
    odometry = Trajectory(np.round(t_s * 1e9).astype(np.int64), np.stack((x, 0.0 * x, 0.0 * x), axis=1))
    motion = Motion(odometry, 0, 0.0, np.zeros(3))
    at_s = np.arange(1.0, 79.0, 0.2)
    count = len(at_s)
    xyt = motion.robot(at_s + jitter_s * rng.standard_normal(count))
    xyt = xyt + rng.standard_normal((count, 3)) * [noise_m, noise_m, 1e-4]
    path = LaserPath(
        row=np.arange(count),
        t_s=at_s,
        xyt=xyt,
        laser_xyt=xyt,
        covariance=np.tile(np.diag([noise_m, noise_m, 1e-4]) ** 2, (count, 1, 1)),
        part=np.zeros(count, dtype=np.int64),
        weak=np.zeros(count, dtype=bool),
        ratio=np.ones(count),
        deviation_m=0.01,
    )
    return path, motion


def test_jitter_of_stamps_is_measured_without_a_turn():
    path, motion = straight(jitter_s=0.02)
    assert white_noise(path, motion).stamps_s == pytest.approx(0.02, rel=0.3)


def test_no_jitter_is_found_where_there_is_none():
    path, motion = straight()
    found = white_noise(path, motion)
    assert found.stamps_s == 0.0
    assert found.position == pytest.approx(1.0, abs=0.4)


def test_a_pose_on_the_way_may_err_more_than_one_at_rest():
    path, motion = straight(noise_m=1e-4)
    deviation = np.sqrt(with_view_errors(path, motion).covariance[:, 0, 0])
    assert np.median(deviation[path.t_s < 60.0]) > 5.0 * np.median(deviation[path.t_s > 61.0])


@pytest.mark.parametrize("long", [1, 3])
def test_a_run_of_wrong_matches_is_left_out_and_nothing_else(long):
    path, motion = straight()
    path.xyt[100 : 100 + long, 1] += 0.1
    kept = without_spikes(path, motion).row
    assert set(path.row) - set(kept) == set(range(100, 100 + long))


def test_a_slip_of_the_odometry_costs_no_pose():
    path, motion = straight()
    path.xyt[100:, 0] += 0.1
    assert len(without_spikes(path, motion)) == len(path)


def test_the_level_leaves_an_axis_that_is_not_seen_alone():
    path, motion = straight()
    path.covariance[::2, 1, 1] += UNKNOWN_M**2
    noisy = with_noise(path, motion, WhiteNoise(0.04, 1.0, 0.0))
    assert noisy.covariance[::2, 1, 1] == pytest.approx(UNKNOWN_M**2, rel=1e-3)
    assert noisy.covariance[:, 0, 0] == pytest.approx(0.04 * path.covariance[:, 0, 0])


def stamped(at_s):
    sweeps = tuple(Sweep(round(1e9 * t), np.zeros((0, 2), np.float32), np.zeros(0, np.float32)) for t in at_s)
    return Sweeps("run", "/scan", "laser", sweeps, 6.0, np.zeros(len(at_s), np.int64), None)


def test_stamps_of_arrival_are_evened_on_both_sides_of_a_gap():
    taken_s = np.concatenate((np.arange(0.0, 30.0, 0.1), np.arange(41.23, 70.0, 0.1)))
    late_s = np.random.default_rng(0).uniform(0.0, 0.08, len(taken_s))
    off_s = 1e-9 * stamped(taken_s + late_s).evened().stamps_ns - taken_s - 0.04
    assert np.median(np.abs(off_s)) < 0.3 * np.median(np.abs(late_s - 0.04))


def test_even_stamps_average_over_the_drive_if_the_rate_is_constant_and_follow_it_if_not():
    late_s = np.abs(0.05 * np.random.default_rng(0).standard_normal(600))
    steady_s = 0.2 * np.arange(600)
    drifting_s = steady_s + 0.3 * np.sin(steady_s / 15.0)
    for taken_s, largest_s in ((steady_s, 0.005), (drifting_s, 0.02)):
        off_s = 1e-9 * even_stamps(np.sort(np.round(1e9 * (taken_s + late_s)).astype(np.int64))) - taken_s
        assert np.abs(off_s - late_s.mean()).max() < largest_s


def test_a_clock_that_is_even_already_is_left_alone_gaps_or_not():
    taken_s = np.arange(0.0, 60.0, 0.2)
    assert stamped(taken_s).evened() is None
    assert stamped(np.delete(taken_s, slice(100, 150))).evened() is None

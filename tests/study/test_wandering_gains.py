"""Correlated noise is estimated beside white noise, so that a simulation drifts like the robot."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from hidden import as_recording
from scipy.signal import lfilter
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.simulation import simulate
from odomcorrupt.study.select.selection import learn

pytestmark = pytest.mark.slow


@cache
def _clean(seed, yaw_from):
    return learn([as_recording(simulate(seed, None, duration_s=600.0, yaw_from=yaw_from))])


def _learned(seed, cause, parameters, yaw_from):
    run = simulate(seed, cause, duration_s=600.0, parameters=parameters, yaw_from=yaw_from)
    clean, noisy = _clean(seed, yaw_from), learn([as_recording(run)])
    return clean.fit.noise.coefficients, noisy.fit.noise.coefficients, [gain.effect for gain in noisy.noise]


@pytest.mark.parametrize("channel", ["along", "yaw", "wheels"])
def test_a_gain_and_its_time_are_found_and_white_noise_stays_what_it_was(channel):
    planted = {"sigma": 0.04, "tau": 8.0, "channel": channel}
    clean, noisy, (found,) = _learned(301, "gauss_markov", planted, yaw_from="encoders")
    assert (found.name, found.channel) == ("gauss_markov", channel)
    assert found.sigma == pytest.approx(0.04, rel=0.3)
    assert 4.0 < found.tau < 16.0
    # what the gain moves between knots 1.5 s apart is left, and looks white: sigma (v h / 3 tau)^0.5 of half a second
    white = ("trans_trans",) if channel == "along" else ("rot_rot", "rot_trans")  # "wheels": a bias of a gyro before
    before, after = (np.hypot.reduce([getattr(k, name) for name in white]) for k in (clean, noisy))
    assert after < 3.0 * before


def test_a_walking_bias_is_measured_and_white_noise_stays_what_it_was():
    clean, noisy, (found,) = _learned(302, "gyro_bias_walk", {"density": 6e-4}, yaw_from="gyro")
    assert found.name == "gyro_bias_walk"
    assert found.density == pytest.approx(6e-4, rel=0.3)
    assert clean.rot_time == pytest.approx(2e-4, rel=0.2)
    # as above, what the bias moves between knots looks white; beside a walk one drive hardly separates noise in time
    # from noise of turns, and the draws of the walk assign it to either
    assert heading_noise(noisy) < 3.0 * heading_noise(clean)


def heading_noise(k):
    """Return the noise of the heading in a second at usual speeds, 0.3 m/s and 0.3 rad/s."""
    return np.sqrt(k.rot_time**2 + 0.3 * (k.rot_rot**2 + k.rot_trans**2))


def test_bursts_do_not_widen_the_noise_of_every_step_and_do_not_turn_a_gyro():
    planted = {"rate": 0.08, "slip": 0.5, "duration": 0.3}
    clean, noisy, found = _learned(303, "slip_burst", planted, yaw_from="gyro")
    (bursts,) = found
    assert (bursts.name, bursts.heading) == ("slip_burst", "gyro")
    assert noisy.trans_trans < 2.0 * clean.trans_trans


def test_a_bias_that_comes_back_is_no_walk_that_runs_away():
    # as a walk, this one would have wandered 3 deg/s away after ten minutes; it never does more than 0.4
    rng, drive = np.random.default_rng(304), wander(304)
    keep = np.exp(-1.0 / RATE_HZ / 8.0)
    kicks = 0.005 * np.sqrt(1.0 - keep**2) * rng.standard_normal(len(drive))
    bias = lfilter([1.0], [1.0, -keep], kicks)
    steps = Increments(drive.ds_m, drive.dl_m, drive.dtheta_rad + bias / RATE_HZ)
    noisy = noisy_path(steps, Coefficients(0.005, 0.005, 0.01, 0.005), 304)
    (found,) = [gain.effect for gain in learn([recording(drive, noisy, seed=304)]).noise]
    assert found.name == "gyro_bias_walk"
    assert found.density * np.sqrt(found.tau / 2.0) == pytest.approx(0.005, rel=0.3)
    assert 4.0 < found.tau < 16.0


def test_headings_of_a_truth_that_err_alike_for_a_second_are_no_bias_of_the_robot():
    # as those of a SLAM that is taken for the truth
    rng, drive = np.random.default_rng(305), wander(305)
    keep, kicks = np.exp(-1.0 / RATE_HZ / 1.0), rng.standard_normal(len(drive) + 1)
    smooth = lfilter([1.0], [1.0, -keep], lfilter([1.0], [1.0, -keep], kicks))
    off = np.stack((0.0 * smooth, 0.0 * smooth, 0.02 * smooth / smooth.std()), axis=1)
    told = recording(drive, noisy_path(drive, Coefficients(0.005, 0.005, 0.01, 0.005), 305), seed=305)
    truth = Trajectory(told.truth.stamps_ns, told.truth.xyt + off)
    assert [gain.effect.name for gain in learn([replace(told, truth=truth)]).noise] == []

"""Acceptance of effects: impossible signs are refused, and others are not."""

from dataclasses import replace

import numpy as np
import pytest
from test_held_out import QUIET, drive, with_truth
from wandering import noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.tails import heavy_tails
from odomcorrupt.study.select.selection import learn


@pytest.mark.slow
@pytest.mark.parametrize("times", [4.4, 1.9, 0.5])
def test_a_robot_that_turns_several_times_as_far_as_its_odometry_says_is_named(times):
    run = with_truth(drive(4, wide=1.0 / times, seconds=120.0), 5)
    learned = learn([run])
    assert learned.added[0] == "wheelbase"
    assert 1.0 / (1.0 + learned.fit.by_name["wheelbase"].e) == pytest.approx(times, rel=0.01)


def inward(seed, k=-0.05):
    """Return a recording whose truth slips into its turns, as no tyre does."""
    steps = wander(seed, 240.0)
    run = recording(steps, noisy_path(steps, QUIET, seed), seed=seed)
    across = -k * steps.ds_m * steps.dtheta_rad * 50.0
    true = accumulate(np.zeros(3), Increments(steps.ds_m, across, steps.dtheta_rad))
    noise = np.random.default_rng(seed).normal(0.0, [0.002, 0.002, 0.003], true.shape)
    return replace(run, truth=Trajectory(run.odometry.stamps_ns, true + noise))


@pytest.mark.slow
def test_a_sign_that_physics_forbids_is_an_alarm_about_the_data_and_no_name():
    learned = learn([inward(3)])
    assert [one.name for one in learned.contradicted] == ["side_slip"]
    assert learned.added == ()
    assert learned.unknown == ()


def test_tails_of_a_truth_that_is_noisier_than_the_odometry_are_not_the_odometrys():
    steps = wander(5, 240.0)
    run = recording(steps, noisy_path(steps, Coefficients(0.002, 0.002, 0.001, 0.001), 5), seed=5)
    true = accumulate(np.zeros(3), steps)
    noise = np.random.default_rng(5).standard_t(2.5, true.shape) * [0.02, 0.02, 0.02]
    noisy = replace(run, truth=Trajectory(run.odometry.stamps_ns, true + noise))
    assert heavy_tails(fit([noisy], approach=choose_approach([noisy]))) is None


@pytest.mark.slow
@pytest.mark.xfail(reason="no basis function has the shape 1 - c / |v|: names fill the gap")
def test_wheels_that_fall_short_at_speed_contradict_no_physics():
    # the opposite of counts that are lost there: its sign is no alarm about the data, and the law is no copy of it
    steps = wander(3, 240.0)
    half = 0.2 * steps.dtheta_rad
    fast = 0.6 / 50.0
    right, left = (u - 0.3 * (u - np.clip(u, -fast, fast)) for u in (steps.ds_m + half, steps.ds_m - half))
    run = replace(recording(steps, noisy_path(steps, QUIET, 3), seed=3), track_m=0.4)
    true = accumulate(np.zeros(3), Increments((right + left) / 2.0, steps.dl_m, (right - left) / 0.4))
    learned = learn([with_truth((run, true), 3)])
    assert [law.name for law in learned.laws] == ["wheels_over_speed"]
    assert learned.added == ()
    assert learned.contradictions == ()

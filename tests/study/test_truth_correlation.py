"""Node spacing exceeds the correlation length of a localisation's errors, so that odometry does not absorb them."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.se2 import accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.calibrate import coefficient_intervals, fit_robot
from odomcorrupt.study.estimate.config import INTERVAL_S, choose_approach, independent_spacing_s
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.intervals import intervals_of
from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.random_effects import random_coefficients

QUIET = Coefficients(0.004, 0.004, 0.002, 0.001)
EVERY = 20
"""Samples of the odometry between two corrections: 0.4 s."""


def localised(*, length_m, seed=3, seconds=260.0, yaw_rate=0.0):
    """Return a drive whose truth errs by 2 cm and 10 mrad, alike over a length of path, and its gyro by a yaw rate."""
    rng, steps = np.random.default_rng(seed), wander(seed, seconds)
    seen = replace(steps, dtheta_rad=steps.dtheta_rad + yaw_rate / RATE_HZ)
    run = recording(steps, noisy_path(seen, QUIET, seed), seed=seed)
    true = accumulate(np.zeros(3), steps)[::EVERY]
    way = np.concatenate(([0.0], np.cumsum(np.abs(steps.ds_m) + 0.2 * np.abs(steps.dtheta_rad))))[::EVERY]
    errors = rng.normal(0.0, [0.02, 0.02, 0.01], true.shape)
    for i in range(1, len(true)):
        kept = np.exp(-(way[i] - way[i - 1]) / length_m)
        errors[i] = kept * errors[i - 1] + np.sqrt(1.0 - kept**2) * errors[i]
    truth = Trajectory(run.odometry.stamps_ns[::EVERY], true + errors)
    return replace(run, truth=truth, localised=True)


@pytest.fixture(scope="module")
def run():
    return localised(length_m=1.0)


def test_errors_that_are_alike_over_a_metre_ask_for_seconds(run):
    assert independent_spacing_s(run) >= 4.0
    assert choose_approach([run]).spacing_s == independent_spacing_s(run)


def test_a_good_truth_keeps_its_close_nodes_and_a_noisy_one_without_correlation_one_second():
    steps = wander(3, 240.0)
    odometry = noisy_path(steps, QUIET, 3)
    assert choose_approach([recording(steps, odometry)]).spacing_s == INTERVAL_S
    noisy = recording(steps, odometry, truth_mm=30.0, truth_rad=0.01)
    assert choose_approach([noisy]).spacing_s == 1.0


def test_a_short_drive_keeps_nodes_enough_for_its_halves():
    assert independent_spacing_s(localised(length_m=1.0, seconds=110.0)) <= 2.0


def test_nodes_are_the_same_for_all_models(run):
    wide = undo(run, [effect_from_values("wheelbase", {"e": 0.2}), effect_from_values("wheel_scale", {"e": -0.1})])
    assert np.array_equal(intervals_of(run, 4.0).start_s, intervals_of(wide, 4.0).start_s)


@pytest.mark.slow
def test_the_noise_of_a_localisation_is_not_learned_as_the_robots(run):
    model = fit_robot([run], (), law_name="diffusion").model
    k, errors = model.noise.coefficients, model.standard_errors
    assert model.setup.truth.xy_m == pytest.approx(0.018, rel=0.3)
    for name in ("rot_trans", "trans_trans"):
        assert getattr(k, name) < getattr(QUIET, name) + 3.0 * errors.get(name, 0.002)
        assert getattr(k, name) < 0.012


@pytest.mark.slow
def test_a_bias_that_walks_is_told_from_one_that_stays_although_nodes_lie_seconds_apart():
    """Noise of every step takes on what a walk does over seconds: the test is beside the noise that a walk leaves."""
    seed, count = 5, int(260.0 * RATE_HZ)
    walk = np.cumsum(np.random.default_rng(seed).normal(0.0, 3e-4 / np.sqrt(RATE_HZ), count))
    found = {}
    for name, yaw_rate in (("walks", walk), ("stays", np.full(count, 0.01)), ("none", np.zeros(count))):
        run = localised(length_m=1.0, seed=seed, yaw_rate=yaw_rate)
        fitted = fit([run], [effect_from_values("gyro_bias", {})], approach=choose_approach([run]))
        found[name] = [one.effect.name for one in random_coefficients(fitted, DECISIONS)]
        walking = fitted.refit(random=[effect_from_values("gyro_bias_walk", {"density": 3e-4})])
        bounds = coefficient_intervals(walking, walking.design_matrix)
        assert all(one.high < 0.03 for one in bounds), "a process in the model is no noise of every step"
    assert found == {"walks": ["gyro_bias_walk"], "stays": [], "none": []}

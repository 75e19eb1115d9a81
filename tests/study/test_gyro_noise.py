"""The angle random walk of a gyro: heading noise that grows with time, also at rest, fitted beside the noise law."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments, accumulate, increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.model_file import format_model, parse_model
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import LAWS, Coefficients
from odomcorrupt.study.estimate.config import Approach, choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.intervals import intervals_between
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.windows import position_windows
from odomcorrupt.study.io.headings import with_headings
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.random_effects import random_coefficients

QUIET = Coefficients(0.0005, 0.0005, 0.002, 0.001)
GYRO = 5e-4
"""Angle random walk of a cheap gyro, rad/sqrt(s)."""


def resting(seed: int, gyro: float, *, walk: float = 0.0):
    """Return a recording of a robot that stands two thirds of the time, with a gyro of white noise and walking bias."""
    n = round(400.0 * RATE_HZ)
    moves = np.arange(n) / RATE_HZ % 30.0 < 10.0
    drive = wander(seed, 400.0)
    steps = Increments(drive.ds_m * moves, drive.dl_m, drive.dtheta_rad * moves)
    rng = np.random.default_rng((7, seed))
    rate = walk * np.cumsum(rng.normal(0.0, 1.0 / np.sqrt(RATE_HZ), n))
    turned = rng.normal(0.0, 1.0, n) * gyro / np.sqrt(RATE_HZ) + rate / RATE_HZ
    of_wheels = increments(noisy_path(steps, QUIET, seed))
    noisy = accumulate(np.zeros(3), replace(of_wheels, dtheta_rad=of_wheels.dtheta_rad + turned))
    return recording(steps, noisy, truth_mm=1.0, truth_rad=0.0015, seed=seed)


def test_white_noise_of_a_gyro_is_noise_over_time_and_no_bias():
    """Without it, a bias that comes back within seconds is found, and noise of turns is several times too large."""
    run = resting(4, GYRO)
    fitted = fit([run], approach=choose_approach([run]))
    k = fitted.noise.coefficients
    assert k.rot_time == pytest.approx(GYRO, rel=0.3)
    assert max(k.rot_rot, k.rot_trans) < 4.0 * QUIET.rot_rot
    assert random_coefficients(fitted, DECISIONS) == []
    without = fit([run], approach=replace(choose_approach([run]), gyro_noise=False))
    assert "gyro_bias_walk" in {one.effect.name for one in random_coefficients(without, DECISIONS)}


def test_a_bias_that_walks_is_found_beside_the_white_noise():
    """Fitted without the walk, the white noise absorbs it: a test beside that noise finds nothing."""
    run = resting(6, GYRO, walk=1.5e-4)
    fitted = fit([run], approach=choose_approach([run]))
    (found,) = random_coefficients(fitted, DECISIONS)
    assert found.effect.name == "gyro_bias_walk"
    assert found.effect.density == pytest.approx(1.5e-4, rel=0.2)


def test_a_heading_from_wheels_has_no_noise_over_time():
    run = resting(3, 0.0)
    assert not choose_approach([run]).gyro_noise
    assert fit([run], approach=choose_approach([run])).noise.coefficients.rot_time == 0.0


@pytest.mark.parametrize("law", ["diffusion", "velocity"])
def test_at_a_constant_yaw_rate_noise_over_time_is_noise_of_turns(law):
    """At w rad/s, rot_time^2 per second is rot_rot^2 w: a check that does not use the code for time."""
    rate, n = 0.4, 1000
    steps = Increments(np.full(n, 0.01), np.zeros(n), np.full(n, rate / RATE_HZ))
    run = recording(steps, accumulate(np.zeros(3), steps))
    problem = pose_problem([run], approach=Approach())
    own = LAWS["diffusion"] if law == "diffusion" else replace_arc(LAWS["diffusion"])
    timed, turned = Coefficients(0, 0, 0, 0, rot_time=0.02), Coefficients(0.02 / np.sqrt(rate), 0, 0, 0)
    for windows in (problem.intervals, of_positions(run)):
        expected = windows.covariance(own, turned, problem.steps)
        np.testing.assert_allclose(windows.covariance(own, timed, problem.steps), expected, rtol=1e-6, atol=1e-15)


def replace_arc(law):
    """Return the law with rot1 along the arc, as that of table 5.3."""
    return law._replace(arc=True)


def of_positions(run):
    """Return windows of 5 s beside a truth of positions only."""
    blind = np.column_stack((run.truth.xyt[:, :2], np.full(len(run.truth), np.nan)))
    run = with_headings(replace(run, truth=Trajectory(run.truth.stamps_ns, blind)))
    return position_windows(run, intervals_between(run, np.arange(100, 900, 250)))


def test_a_model_file_has_it_with_its_unit():
    noise = Noise("diffusion", replace(QUIET, rot_time=GYRO))
    text = format_model(MotionModel(noise))
    assert "rot_time = 0.0005  # rad per sqrt(s)" in text
    assert parse_model(text).noise == noise

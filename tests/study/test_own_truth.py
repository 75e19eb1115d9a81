"""The truth noise of a second recording is estimated separately, and does not absorb errors of the robot."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup, TruthNoise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.validate.evaluation import evaluate_stretch

QUIET = Coefficients(0.003, 0.001, 0.002, 0.0)
STATED = TruthNoise(0.003, 0.003, 0.0)
MODEL = MotionModel(Noise("diffusion", QUIET), setup=Setup(truth=STATED))


def slipping(slips, *, every_s=0.0, truth_mm=3.0, truth_rad=0.003):
    """Return two minutes in which some seconds, or parts of every few, turn the odometry by 12 degrees too much."""
    steps = wander(5, 120.0)
    turned = steps.dtheta_rad.copy()
    for at in slips:
        turned[at * 50 : at * 50 + 50] += np.radians(12.0) / 50.0
    if every_s:
        turned += np.random.default_rng(1).normal(0.0, np.radians(0.5), len(turned))
    run = recording(steps, noisy_path(steps, QUIET, 5), truth_mm=truth_mm, truth_rad=truth_rad, seed=5)
    path = noisy_path(Increments(steps.ds_m, steps.dl_m, turned), QUIET, 5)
    return replace(run, odometry=replace(run.odometry, xyt=path))


def judged(run, model=MODEL):
    return evaluate_stretch(run, model, Approach())


def test_slips_are_not_taken_for_noise_of_the_truth():
    piece = judged(slipping((20, 35, 50, 70, 90)))
    assert piece.truth == STATED
    # and so they stand out
    assert np.sum(piece.innovations.reshape(-1, 3) ** 2, axis=1).max() > 1000.0


def test_a_robot_that_is_noisier_throughout_is_not_excused_by_a_truth_whose_samples_are_good():
    piece = judged(slipping((), every_s=0.02))
    assert piece.truth.yaw_rad < 0.02
    assert np.mean(piece.innovations**2) > 2.0


def test_a_truth_that_is_noisier_is_judged_as_such():
    piece = judged(slipping((), truth_mm=20.0, truth_rad=0.02))
    assert piece.truth.xy_m == pytest.approx(0.02, rel=0.15)
    assert piece.truth.yaw_rad == pytest.approx(0.02, rel=0.15)
    assert np.mean(piece.innovations**2) == pytest.approx(1.0, abs=0.2)


def test_a_model_that_states_none_estimates_it_without_the_slips():
    piece = judged(slipping((20, 35, 50, 70, 90)), MotionModel(Noise("diffusion", QUIET)))
    assert piece.truth.xy_m == pytest.approx(0.003, rel=0.3)
    assert piece.truth.yaw_rad == pytest.approx(0.003, rel=0.5)

"""Simulated runs of a correct model contain the measured path with the nominal frequency."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import noisy_path, recording, wander

from odomcorrupt.model.motion_model import MotionModel, Noise, Setup, TruthNoise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.validate.evaluation import evaluate_stretch
from odomcorrupt.study.validate.predictive_check import replay

PLANTED = Coefficients(0.05, 0.02, 0.05, 0.01)
RIGHT = MotionModel(Noise("diffusion", PLANTED), setup=Setup(truth=TruthNoise(0.003, 0.003, 0.0)))


def replayed(seed: int, model: MotionModel = RIGHT, runs: int = 60):
    steps = wander(seed, 60.0)
    run = recording(steps, noisy_path(steps, PLANTED, seed), seed=seed)
    return replay(evaluate_stretch(run, model, Approach("truth")), runs=runs)


def inside(model: MotionModel, parts: list[float], drives: int) -> list[float]:
    """Return the share of drives whose end is within each part of the runs of a model."""
    found = []
    for seed in range(drives):
        paths = replayed(seed, model)
        found.append([paths.inside(np.array([len(paths.distance_m) - 1]), part)[0] for part in parts])
    return list(np.mean(found, axis=0))


@pytest.mark.slow
def test_a_right_model_covers_the_end_of_the_drive_at_its_level():
    most, half = inside(RIGHT, [0.9, 0.5], 60)
    assert most == pytest.approx(0.9, abs=0.1)
    assert half == pytest.approx(0.5, abs=0.17)
    timid = replace(RIGHT, noise=Noise("diffusion", Coefficients(0.015, 0.006, 0.015, 0.003)))
    assert inside(timid, [0.9], 20)[0] < 0.5


def test_runs_start_at_the_truth_and_are_the_same_every_time():
    paths, again = replayed(1, runs=20), replayed(1, runs=20)
    np.testing.assert_array_equal(paths.runs_xyt, again.runs_xyt)
    assert np.abs(paths.runs_xyt[:, 0] - paths.truth_xyt[0]).max() < 5.0 * 0.003
    np.testing.assert_allclose(paths.measured_xyt[0, :2], paths.truth_xyt[0, :2], atol=1e-12)
    assert np.std(paths.runs_xyt[:, -1, 0]) > 0.02


def test_too_few_runs_are_refused():
    with pytest.raises(ValueError, match="20 or more"):
        replayed(1, runs=3)

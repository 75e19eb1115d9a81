"""Predicted sizes of window errors beside a truth of positions only, whose headings are estimated."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2
from wandering import noisy_path, recording, wander

from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup, TruthNoise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.io.headings import with_headings
from odomcorrupt.study.validate.evaluation import evaluate_stretch, horizons_of

EVERY = 10
"""Poses of the odometry per position: 5 Hz."""


def judged(seed: int, truth_mm: float, k: Coefficients):
    steps = wander(seed, 150.0)
    run = recording(steps, noisy_path(steps, k, seed), truth_mm=truth_mm, seed=seed)
    xyt = np.column_stack((run.truth.xyt[::EVERY, :2], np.full(len(run.truth.xyt[::EVERY]), np.nan)))
    run = with_headings(replace(run, truth=Trajectory(run.truth.stamps_ns[::EVERY], xyt)))
    model = MotionModel(Noise("diffusion", k), setup=Setup(truth=TruthNoise(truth_mm * 1e-3, 0.5, 0.0)))
    return evaluate_stretch(run, model, Approach("truth"))


@pytest.mark.parametrize(
    ("truth_mm", "k"),
    [(100.0, Coefficients(0.01, 0.004, 0.01, 0.002)), (12.0, Coefficients(0.02, 0.02, 0.01, 0.002))],
    ids=["radio", "satellites"],
)
def test_errors_are_as_large_as_a_right_model_predicts(truth_mm, k):
    for h in horizons_of([judged(seed, truth_mm, k) for seed in range(3)], (1.0, 2.0, 5.0, 10.0, 20.0)):
        low, high = np.sqrt(chi2.ppf([0.001, 0.999], h.windows) / h.windows)
        for channel in (0, 1):
            assert low < h.measured[channel] / h.expected[channel] < high, f"{h.distance_m} m, channel {channel}"
        assert h.nees_p > 0.002, f"{h.distance_m} m"

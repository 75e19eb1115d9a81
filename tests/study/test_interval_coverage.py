"""Confidence intervals contain the planted values in about 95 % of many drives."""

import numpy as np
import pytest
from scipy.stats import binom
from wandering import noisy_path, recording, wander

from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.calibrate import coefficient_intervals
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit

PLANTED = Coefficients(0.05, 0.02, 0.05, 0.01)
SEEDS = range(300, 320)


@pytest.mark.slow
@pytest.mark.parametrize("truth_mm", [1.0, 5.0])
def test_planted_coefficients_lie_in_their_intervals(truth_mm):
    inside: dict[str, list[bool]] = {}
    for seed in SEEDS:
        steps = wander(seed, 600.0)
        run = recording(steps, noisy_path(steps, PLANTED, seed), truth_mm=truth_mm, seed=seed)
        fitted = fit([run], approach=choose_approach([run]))
        for interval in coefficient_intervals(fitted, np.zeros((len(fitted.problem.intervals), 3, 0))):
            planted = getattr(PLANTED, interval.name)
            if planted > 0.0:
                inside.setdefault(interval.name, []).append(interval.low <= planted <= interval.high)
    assert inside.keys() == {"rot_rot", "rot_trans", "trans_trans", "trans_rot"}
    for name, hits in inside.items():
        # as few as this happen to a right interval once in a thousand
        assert sum(hits) >= binom.ppf(0.001, len(hits), 0.95), f"{name}: {sum(hits)} of {len(hits)}"
    every = np.concatenate(list(inside.values()))
    assert 0.9 <= every.mean() <= 1.0

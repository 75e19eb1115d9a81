"""Windows of a drive share a slow random process: their errors are no independent evidence on its size."""

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.effects import effect_from_values
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.problem import pose_problem
from odomcorrupt.study.estimate.windows import WindowErrors, distance_windows
from odomcorrupt.study.validate.process_windows import process_roots, random_covariance


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("gauss_markov", {"sigma": 0.02, "tau": 30.0, "channel": "along"}),
        ("gauss_markov", {"sigma": 0.02, "tau": 30.0, "channel": "wheels"}),
        ("gyro_bias_walk", {"density": 1e-3, "tau": 40.0}),
    ],
)
def test_what_windows_share_has_the_covariance_of_each_of_them(name, values):
    recording = as_recording(simulate(93, None, duration_s=180.0))
    problem = pose_problem([recording], approach=choose_approach([recording]))
    windows, motion = distance_windows(problem.left[0], 2.0), problem.motions[0]
    effect = effect_from_values(name, values)
    root, own = process_roots([effect], windows, motion), random_covariance([effect], windows, motion)
    shared = np.einsum("kim,kjm->kij", root, root)
    there = np.einsum("kii->ki", own) > 1e-8
    ratio = np.einsum("kii->ki", shared)[there] / np.einsum("kii->ki", own)[there]
    # a process between its knots varies less; forth and back over one of them it cancels
    assert np.quantile(ratio, 0.1) > 0.9
    assert np.quantile(ratio, 0.9) < 1.1


def test_the_sum_of_squares_over_windows_varies_more_beside_a_slow_process():
    recording = as_recording(simulate(93, None, duration_s=180.0))
    problem = pose_problem([recording], approach=choose_approach([recording]))
    windows, motion = distance_windows(problem.left[0], 2.0), problem.motions[0]
    slow, fast = (effect_from_values("gauss_markov", {"sigma": 0.02, "tau": tau}) for tau in (100.0, 2.0))
    spread = []
    for effect in (slow, fast):
        covariance = random_covariance([effect], windows, motion)[:, :1, :1] + 1e-6
        errors = WindowErrors(np.zeros((len(windows), 1)), covariance, process_roots([effect], windows, motion)[:, :1])
        spread.append(np.sum(errors.spectrum**2) / len(windows))
    assert spread[0] > 4.0 * spread[1]
    assert process_roots([effect_from_values("slip_burst", {})], windows, motion) is None

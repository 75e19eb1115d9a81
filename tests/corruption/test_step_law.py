"""Book laws applied once per distance."""

from __future__ import annotations

import numpy as np
import pytest
from drives import LAW_COEFFICIENTS, textbook_sigmas

from odomcorrupt.corruption.path import StepGrowth, noise_variances
from odomcorrupt.geometry.se2 import Increments
from odomcorrupt.model.motion_model import Noise, Step


def crawl(law, k, step, moves):
    """Walk along a path from one end of a step or of a move to the next: slow and obvious."""
    gone_m = gone_rad = 0.0
    out = []
    for ds, dtheta in np.abs(moves):
        left, grown = 1.0, np.zeros(3)
        while left > 0.0:
            by_m = (step.distance_m - gone_m) / ds if ds > 0 else np.inf
            by_rad = (step.angle_rad - gone_rad) / dtheta if dtheta > 0 else np.inf
            part = min(left, by_m, by_rad)
            before = np.square(textbook_sigmas(law, k, gone_rad / 2, gone_m, gone_rad / 2))
            gone_m, gone_rad, left = gone_m + part * ds, gone_rad + part * dtheta, left - part
            grown += np.square(textbook_sigmas(law, k, gone_rad / 2, gone_m, gone_rad / 2)) - before
            if part in {by_m, by_rad}:
                gone_m = gone_rad = 0.0
        out.append(grown)
    return np.array(out)


@pytest.mark.parametrize("law", ["linear", "quadratic", "velocity", "omni"])
def test_growth_within_steps_agrees_with_crawling_along_the_path(law):
    rng = np.random.default_rng(3)
    moves = np.column_stack((rng.uniform(-0.3, 0.7, 60), rng.uniform(-0.5, 0.5, 60)))
    moves[10:14] = 0.0
    moves[20] = 2.4, 0.0
    step = Step(0.25, 0.2)
    got = noise_variances(
        Noise(law, LAW_COEFFICIENTS[law], step),
        Increments(moves[:, 0], np.zeros(60), moves[:, 1]),
        np.ones(60),
        StepGrowth(),
    ).variances
    expected = crawl(law, LAW_COEFFICIENTS[law], step, moves)
    for ours, theirs in zip((got.rot1, got.trans, got.rot2), expected.T, strict=True):
        assert ours == pytest.approx(theirs, rel=1e-9, abs=1e-14)
    assert not got.rot1[10:14].any()


def test_an_increment_of_many_whole_steps_counts_each():
    k = LAW_COEFFICIENTS["linear"]
    got = noise_variances(
        Noise("linear", k, Step(0.25, 0.2)),
        Increments(np.array([1.0]), np.zeros(1), np.zeros(1)),
        np.ones(1),
        StepGrowth(),
    )
    assert got.variances.rot1[0] == pytest.approx(4 * (k.rot_trans * 0.25) ** 2)
    assert got.variances.trans[0] == pytest.approx(4 * (k.trans_trans * 0.25) ** 2)
    assert got.growth.began_m == pytest.approx(1.0)


def test_no_increments_are_no_variance():
    got = noise_variances(
        Noise("linear", LAW_COEFFICIENTS["linear"], Step(1, 1)),
        Increments(*np.zeros((3, 0))),
        np.zeros(0),
        StepGrowth(0.3, 0.1),
    )
    assert len(got.variances.rot1) == 0
    assert got.growth == StepGrowth(0.3, 0.1)

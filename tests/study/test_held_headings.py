"""Steering that holds the true heading: thresholds of the yaw rate below its noise select intervals by their error."""

from __future__ import annotations

import numpy as np
import pytest
from wandering import RATE_HZ, recording

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.increments import Increments, accumulate
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select.closed_loop import least_thresholds
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.model_comparison import compare_with_basis
from odomcorrupt.study.select.screening import CoarseDesign
from odomcorrupt.study.select.stepwise import learn

CURVATURE, ROT_TRANS, V = 0.013, 0.007, 0.5


def held_on_line(seed, curvature=CURVATURE, duration_s=240.0):
    """A drive of straights and turns on the spot with unequal wheels, whose true heading is held within 0.4 s."""
    rng = np.random.default_rng(seed)
    n, dt = int(duration_s * RATE_HZ), 1.0 / RATE_HZ
    goal, heading, rate = 0.0, 0.0, 0.0
    commanded, turned, gone = np.zeros(n), np.zeros(n), np.zeros(n)
    until = 0
    for i in range(n):
        if i == until:
            goal += rng.choice([-1.0, 1.0]) * rng.uniform(0.8, 2.5)
            until += int(rng.uniform(6.0, 12.0) * RATE_HZ)
        wanted = np.clip(2.5 * (goal - heading), -1.0, 1.0)
        rate += np.clip(wanted - rate, -2.0 * dt, 2.0 * dt)
        gone[i] = V * dt if abs(goal - heading) < 0.3 else 0.0
        commanded[i] = rate * dt
        turned[i] = commanded[i] - curvature * gone[i] + ROT_TRANS * np.sqrt(gone[i]) * rng.standard_normal()
        heading += turned[i]
    zeros = np.zeros(n)
    odometry = accumulate(np.zeros(3), Increments(gone, zeros, commanded))
    return recording(Increments(gone, zeros, turned), odometry, truth_mm=1.0, truth_rad=0.0003, seed=seed)


def test_unequal_wheels_are_not_taken_for_a_threshold_within_the_noise_of_the_yaw_rate():
    run = held_on_line(3)
    fitted = fit([run], [effect_from_values("unequal_wheels", {"curvature": 0.0})], approach=Approach())
    least = least_thresholds(fitted)
    # noise of half a second: 0.007 rad / sqrt(m) * sqrt(0.25 m) / 0.5 s, three times
    assert 0.015 < least["yaw_rate"] < 0.03
    plain, found = (
        compare_with_basis(fitted, fitted.effects, DECISIONS, CoarseDesign(fitted.problem, limits)).margin
        for limits in ({}, least)
    )
    assert found > DECISIONS.alternative_nats > plain


@pytest.mark.slow
def test_the_yaw_rate_with_which_unequal_wheels_are_counteracted_is_no_threshold():
    run = held_on_line(3, curvature=0.04)
    fitted = fit([run], [effect_from_values("unequal_wheels", {"curvature": 0.0})], approach=Approach())
    # the controller turns the robot at 0.04 rad/m * 0.5 m/s, with the noise about that
    assert 0.02 + 0.015 < least_thresholds(fitted)["yaw_rate"] < 0.02 + 0.03
    assert learn([run]).laws == ()

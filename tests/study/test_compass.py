"""A compass deflected by iron on the robot: found with the time constant of its filter, and corrected elsewhere."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording, ten_second_error
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.se2 import Increments
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.elimination import backward_eliminate
from odomcorrupt.study.select.selection import learn

QUIET = Coefficients(0.006, 0.006, 0.004, 0.002)
K, M, TAU_S = 0.09, -0.05, 3.0


def drive(seed, *, deflected=True):
    """Return a recording whose odometry takes its heading from such a compass, low-pass filtered."""
    steps = wander(seed, 200.0)
    heading = np.cumsum(steps.dtheta_rad)
    error = np.full(len(heading), K)
    for i in range(1, len(heading)):
        towards = K * np.cos(heading[i]) + M * np.sin(heading[i])
        error[i] = error[i - 1] + (towards - error[i - 1]) / (TAU_S * RATE_HZ)
    turns = steps.dtheta_rad + np.diff(error, prepend=K) * deflected
    return recording(steps, noisy_path(replace(steps, dtheta_rad=turns), QUIET, seed), truth_mm=2.0, seed=seed)


@pytest.mark.slow
def test_a_filtered_compass_is_found_with_its_time_constant_and_corrected_on_another_drive():
    learned = learn([drive(500)])
    (compass,) = learned.fit.effects
    assert compass.name == "hard_iron"
    assert (compass.k, compass.m) == (pytest.approx(K, abs=0.01), pytest.approx(M, abs=0.01))
    assert compass.time_constant == pytest.approx(TAU_S, rel=0.1)
    after, floor = ten_second_error([drive(501)], [compass]), ten_second_error([drive(501, deflected=False)])
    assert after < 1.1 * floor < 0.5 * ten_second_error([drive(501)])


def test_a_wave_of_the_heading_that_would_have_to_be_larger_than_any_compass_is_dropped():
    """On one line any amplitude fits, and a later term may drive it to its bound."""
    turned = np.linspace(0.0, 6.0 * np.pi, 6001)
    steps = Increments(np.full(6000, 0.01), np.zeros(6000), np.diff(turned + 0.6 * np.cos(turned)))
    made = recording(steps, noisy_path(replace(steps, dtheta_rad=np.diff(turned)), QUIET, 3), truth_mm=2.0, seed=3)
    wave, scale = effect_from_values("hard_iron", {"k": 0.3}), effect_from_values("wheelbase", {})
    fitted = fit([made], [wave, scale], approach=choose_approach([made]))
    assert fitted.wald["hard_iron"] > 20.0 * DECISIONS.drop_nats
    assert abs(fitted.by_name["hard_iron"].k) == 0.35
    assert "hard_iron" not in backward_eliminate(fitted, (), DECISIONS).by_name
    assert "hard_iron" in backward_eliminate(fitted, ("hard_iron",), DECISIONS).by_name


@pytest.mark.slow
def test_a_compass_without_a_filter_has_no_time_constant():
    learned = learn([as_recording(simulate(81, "magnetic_heading", robot_seed=81, size=2.0))])
    (compass,) = learned.fit.effects
    assert compass.name == "hard_iron"
    assert compass.time_constant == 0.0

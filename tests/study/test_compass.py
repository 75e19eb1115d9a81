"""A compass deflected by iron on the robot: found with the time constant of its filter, and corrected elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording, ten_second_error
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.simulation import simulate
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


@pytest.mark.slow
def test_a_compass_without_a_filter_has_no_time_constant():
    learned = learn([as_recording(simulate(81, "magnetic_heading", robot_seed=81, size=2.0))])
    (compass,) = learned.fit.effects
    assert compass.name == "hard_iron"
    assert compass.time_constant == 0.0

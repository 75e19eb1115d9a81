"""A localisation with errors correlated over seconds does not bias the odometry's noise."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select.selection import learn

STEADY = Coefficients(0.0015, 0.0015, 0.001, 0.0005)
RATE_S = 0.4
"""Between two corrections of a localisation."""


def localised(seed, *, bias=0.0, fades_s=3.0, seconds=420.0):
    """Return a recording whose truth errs by 2 cm and half a degree, alike for so many seconds."""
    steps = wander(seed, seconds)
    run = recording(steps, noisy_path(steps, STEADY, seed), seed=seed)
    turned = Increments(steps.ds_m, steps.dl_m, steps.dtheta_rad + bias / 50.0)
    rows = slice(0, None, round(RATE_S * 50.0))
    true, rng = accumulate(np.zeros(3), turned)[rows], np.random.default_rng(seed)
    keeps = np.exp(-RATE_S / fades_s) if fades_s else 0.0
    error = rng.normal(0.0, [0.02, 0.02, 0.009], true.shape)
    for i in range(1, len(error)):
        error[i] = keeps * error[i - 1] + np.sqrt(1.0 - keeps**2) * error[i]
    return replace(run, truth=Trajectory(run.odometry.stamps_ns[rows], true + error), localised=True)


def test_the_truths_own_errors_are_no_noise_of_the_odometry():
    run = localised(3)
    fitted = fit([run], approach=choose_approach([run]))
    assert fitted.noise.truth.yaw_rad == pytest.approx(0.009, rel=0.4)
    assert fitted.noise.coefficients.rot_rot < 0.006


@pytest.mark.slow
def test_a_small_bias_of_the_gyro_is_found_beside_a_localisation():
    learned = learn([localised(3, bias=0.001)])
    (bias,) = (effect.bias for effect in learned.fit.effects if effect.name == "gyro_bias")
    assert bias == pytest.approx(-0.001, rel=0.2)
    assert learn([localised(3)]).added == ()

"""Correlations reported by a fit agree with those of its estimates over repeated recordings."""

import numpy as np
import pytest
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.se2 import Increments
from odomcorrupt.model.model_file import format_model, parse_model
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.calibrate import fit_correlation, fit_robot
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit

PLANTED = Coefficients(0.04, 0.03, 0.04, 0.02)
NAMES = ("rot_rot", "rot_trans", "trans_trans", "trans_rot")


def left_arcs(duration_s=90.0):
    """A drive of left curves, some narrower: track and straightness are hard to tell apart."""
    n = int(duration_s * RATE_HZ)
    t = np.arange(n) / RATE_HZ
    v, omega = 0.5 + 0.1 * np.sin(t / 3.0), 0.4 + 0.12 * np.sin(t / 7.0)
    return Increments(v / RATE_HZ, np.zeros(n), omega / RATE_HZ)


@pytest.mark.slow
def test_reported_correlations_are_those_of_many_fits():
    steps = left_arcs()
    effects = [effect_from_values(name, {}) for name in ("wheelbase", "unequal_wheels")]
    estimates, told = [], []
    for seed in range(40):
        run = recording(steps, noisy_path(steps, PLANTED, seed), truth_mm=1.0, truth_rad=0.001, seed=seed)
        approach = choose_approach([run], "diffusion")
        found = fit([run], effects, approach=approach)
        k = found.noise.coefficients
        estimates.append([found.effects[0].e, found.effects[1].curvature, *(getattr(k, name) for name in NAMES)])
        known = {"wheelbase.e", "unequal_wheels.curvature", *NAMES}
        one = fit_correlation(found, found.design_matrix, known)
        matrix = one.among(["wheelbase.e", "unequal_wheels.curvature", *NAMES])
        if len(matrix) == 6:
            told.append(matrix.matrix)
    assert len(told) > 20
    shown, told = np.corrcoef(np.array(estimates).T), np.median(told, axis=0)
    assert told[0, 1] > 0.9
    # of forty draws a correlation of 0 shows up to 0.35 either way
    np.testing.assert_allclose(told, shown, atol=0.4)
    assert abs(told[0, 1] - shown[0, 1]) < 0.05
    assert not told[:2, 2:].any()


def test_fitted_model_keeps_its_correlations_in_its_file():
    steps = wander(3, 120.0)
    run = recording(steps, noisy_path(steps, PLANTED, 3), seed=3)
    model = fit_robot([run], [effect_from_values(name, {}) for name in ("wheel_scale", "lever_arm")],
                      law_name="diffusion").model  # fmt: skip
    names = model.correlation.names
    assert "wheel_scale.e" in names
    assert "trans_trans" in names
    assert not any(name.startswith("lever_arm") for name in names)
    again = parse_model(format_model(model))
    assert set(again.correlation.names) == set(names)

"""The mean effect of a flat spot is part of that effect; radii that differ in addition are a second one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.se2 import Increments
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.elimination import absorb

QUIET, TRACK_M = Coefficients(0.004, 0.004, 0.002, 0.001), 0.4
SPOT = effect_from_values("flat_spot", {"depth": 0.1, "circumference": 0.9, "phase": 1.0, "mean": 1.0})


def rolled(curvature):
    """Return a drive on a right wheel with a flat side, whose odometry bends by so much per metre besides."""
    steps = wander(6, 240.0)
    true = np.stack((steps.ds_m, steps.dl_m, steps.dtheta_rad + curvature * steps.ds_m), axis=1)
    t_s = np.arange(1, len(true) + 1) / RATE_HZ
    counted = SPOT.recorded(true, t_s, TRACK_M, SPOT.start(np.random.default_rng(0))).steps
    return replace(recording(steps, noisy_path(Increments(*counted.T), QUIET, 6), seed=6), track_m=TRACK_M)


def effects_left(run):
    """Return what is left of a flat side, the radii free beside it."""
    radii = [effect_from_values(name, {}) for name in ("unequal_wheels", "wheel_scale")]
    fitted = fit([run], [*radii, replace(SPOT, depth=0.0, mean=0.0)], approach=Approach())
    return absorb(fitted, (), DECISIONS).effects


def test_a_smaller_radius_is_a_part_of_a_flat_side():
    (found,) = effects_left(rolled(0.0))
    assert (found.name, found.mean) == ("flat_spot", 1.0)
    assert found.depth == pytest.approx(0.1, rel=0.15)


def test_radii_that_differ_besides_are_no_part_of_it():
    assert {"unequal_wheels", "flat_spot"} <= {effect.name for effect in effects_left(rolled(0.03))}

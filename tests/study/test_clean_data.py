"""Without a hidden effect none is found, for noise in the odometry (noise laws) and in the contact (wheels)."""

import numpy as np
import pytest
from hidden import as_recording
from wandering import noisy_path, recording, wander

from odomcorrupt.effects import registry
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select.candidates import score_terms
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.dictionary import Dictionary, families
from odomcorrupt.study.select.selection import learn

SEEDS = range(12)


def z_scores(run) -> dict[str, float]:
    """Return estimate over error of every effect, each tried alone."""
    fitted = fit([run], approach=choose_approach([run]))
    scores = score_terms(fitted, [family[0] for family in families(fitted) if len(family) == 1], Dictionary(DECISIONS))
    return {s.effect.name: float(np.max(np.abs(s.estimate / s.standard_error))) for s in scores if s.separable}


def own_noise(seed):
    steps = wander(seed)
    return recording(steps, noisy_path(steps, Coefficients(0.05, 0.02, 0.05, 0.01), seed), seed=seed)


def wheels(seed):
    return as_recording(simulate(seed, None))


@pytest.mark.slow
@pytest.mark.parametrize("source", [own_noise, wheels])
def test_every_estimate_is_zero_within_its_error_on_clean_data(source):
    scores = [z_scores(source(seed)) for seed in SEEDS]
    for name in scores[0]:
        z = np.array([s[name] for s in scores if name in s])
        assert np.sqrt(np.mean(z**2)) < 1.8, f"{name}: {z}"
        assert z.max() < 4.5, f"{name}: {z}"


@pytest.mark.slow
@pytest.mark.parametrize("seed", [400, 403])
def test_weak_noise_of_the_odometry_is_no_dependence_on_its_own_yaw_rate(seed):
    # breaks where a curve has knots as near to each other as the odometry's noise: on straights both are the same
    steps = wander(seed, 300.0)
    odometry = noisy_path(steps, Coefficients(0.006, 0.006, 0.004, 0.002), seed)
    learned = learn([recording(steps, odometry, truth_mm=1.0, truth_rad=0.002, seed=seed)])
    assert (learned.added, learned.unknown) == ((), ())


def test_registry_holds_the_first_eight_effects():
    first = {
        "wheel_scale",
        "unequal_wheels",
        "wheelbase",
        "gyro_bias",
        "side_slip",
        "time_offset",
        "lever_arm",
        "mount_yaw",
    }
    assert first <= set(registry())

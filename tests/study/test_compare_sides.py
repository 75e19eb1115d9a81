"""Models in a `compare` table are measured on the same stretches; notes name only effects that are not counted."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import noisy_path, recording, wander

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup, TruthNoise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.report.comparison import comparison_text
from odomcorrupt.study.io.recording import content_of
from odomcorrupt.study.validate.compare import compare

PLANTED = Coefficients(0.05, 0.02, 0.05, 0.01)
RIGHT = MotionModel(Noise("diffusion", PLANTED), setup=Setup(truth=TruthNoise(0.003, 0.003, 0.0)))


@pytest.fixture(scope="module")
def run():
    steps = wander(3, 150.0)
    return recording(steps, noisy_path(steps, PLANTED, 3), seed=3)


def test_a_model_without_effects_has_the_path_errors_of_the_odometry_though_it_is_judged_in_halves(run):
    fitted_here = replace(RIGHT, source={"fitted": [content_of(run)]})
    found = compare([run], {"own": fitted_here})
    assert found.evaluations[0].trajectory == found.clock_trajectory
    assert found.evaluations[0].ten_second_error_m == found.clock_error_m
    whole = compare([run], {"other's": RIGHT})
    assert "paths, in halves" in comparison_text(found)
    assert "whole paths" in comparison_text(whole)
    # a path twice as long drifts farther: the two are not to be compared
    assert whole.clock_trajectory.ate_origin_m != found.clock_trajectory.ate_origin_m


def test_notes_name_the_random_effects_that_are_not_counted_and_no_others(run):
    wandering = effect_from_values("gauss_markov", {"sigma": 0.01, "tau": 5.0})
    tails = effect_from_values("heavy_tails", {})
    counted = compare([run], {"m": replace(RIGHT, effects=(wandering,))}).evaluations[0]
    assert not any("do not include" in note for note in counted.notes)
    left_out = compare([run], {"m": replace(RIGHT, effects=(wandering, tails))}).evaluations[0]
    note = next(note for note in left_out.notes if "do not include" in note)
    assert "heavy_tails" in note
    assert "gauss_markov" not in note


@pytest.mark.slow
def test_a_truth_of_positions_alone_shows_the_fall_that_headings_would_show():
    """Headings made of the odometry are no measurement: a model refitted on half a drive must not be fitted to them."""
    steps = wander(5, 240.0)
    turning = replace(steps, dtheta_rad=steps.dtheta_rad + 0.004 / 50.0)
    seen = recording(steps, noisy_path(turning, Coefficients(0.002, 0.001, 0.003, 0.001), 5), seed=5)
    no_yaw = np.column_stack((seen.truth.xyt[:, :2], np.full(len(seen.truth), np.nan)))
    blind = replace(seen, truth=Trajectory(seen.truth.stamps_ns, no_yaw))
    known = {"fitted": [content_of(seen)]}
    plain = MotionModel(Noise("diffusion", PLANTED), source=known)
    biased = replace(plain, effects=(effect_from_values("gyro_bias", {"bias": 0.004}),))
    falls = []
    for run in (seen, blind):
        before, after = (j.ten_second_error_m for j in compare([run], {"plain": plain, "biased": biased}).evaluations)
        falls.append(after / before)
    with_headings, positions_alone = falls
    assert with_headings < 0.5
    assert positions_alone == pytest.approx(with_headings, abs=0.15)

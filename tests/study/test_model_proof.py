"""A model is written only if it can be read back, and used to correct and corrupt; learning finds what it put in."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import recording, wander

from odomcorrupt.correction import undo
from odomcorrupt.corruption.path import NoisyPath
from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.geometry.se2 import accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.model_file import format_model, parse_model
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.select.selection import learn
from odomcorrupt.study.validate.round_trip import _corrected_error, _drive, _fitted_error, verified_model

NOISE = Noise("diffusion", Coefficients(0.01, 0.01, 0.005, 0.001))


@pytest.fixture(scope="module")
def drive():
    steps = wander(3, 120.0)
    return recording(steps, accumulate(np.zeros(3), steps))


def corrupted(model, drive, run=0):
    return NoisyPath(model, 5, run).feed(drive.odometry.stamps_ns, drive.odometry.xyt).error_xyt


def test_what_no_odometry_satisfies_is_left_out_and_said(drive):
    stuck = user_effect("stuck", "along += -3 * v * k * max(abs(v) - 0.1, 0)", {"k": 1.0})
    scale = effect_from_values("wheel_scale", {"e": 0.02})
    found = verified_model(MotionModel(NOISE, (scale, stuck)), [drive])
    assert found.model.effects == (scale,)
    assert all(words in found.changes[0] for words in ("stuck (k = 1", "left out"))
    assert parse_model(format_model(found.model)).source["remarks"] == list(found.changes)
    assert found.left_out == {"stuck": found.changes[0].rpartition(": ")[2]}


@pytest.mark.slow
def test_a_number_beyond_its_bounds_is_written_within_them_and_named(drive):
    wanders = replace(effect_from_values("gauss_markov", {"sigma": 0.3}), sigma=0.8)
    found = verified_model(MotionModel(NOISE, (wanders,)), [drive])
    assert parse_model(format_model(found.model)).effects[0].sigma == 0.5
    assert "gauss_markov.sigma: 0.8 was fitted" in found.changes[0]
    assert any("gauss_markov.sigma = 0.5 is at its physical bound" in change for change in found.changes)


def test_a_robot_that_turns_4_times_as_far_is_informed_that_its_nominal_values_are_wrong(drive):
    found = verified_model(MotionModel(NOISE, (effect_from_values("wheelbase", {"e": 1.0 / 4.4 - 1.0}),)), [drive])
    assert len(found.changes) == 1
    assert "turns 4.4 times as far as its odometry reports" in found.changes[0]
    assert np.isfinite(corrupted(found.model, drive)).all()


def test_correct_and_fit_tell_why_their_errors_differ(drive):
    setup = replace(MotionModel(NOISE).setup, effects=(effect_from_values("lever_arm", {"x": 0.2}),))
    model = MotionModel(NOISE, setup=setup)
    (said,) = verified_model(model, [drive]).changes
    assert "`correct` with this model leaves" in said
    assert "lever_arm" in said


def test_a_sound_model_is_left_as_it_is(drive):
    model = MotionModel(
        NOISE, (effect_from_values("wheelbase", {"e": 0.02}), effect_from_values("side_slip", {"k": 0.03}))
    )
    found = verified_model(model, [drive])
    assert (found.changes, found.left_out) == ((), {})
    assert found.model == model


@pytest.mark.slow
def test_of_rough_odometry_a_correction_takes_what_the_fit_took(drive, monkeypatch):
    # from one pose to the next it seems to brake hard half of the time
    rough = drive.odometry.xyt + np.random.default_rng(2).normal(0.0, [1e-3, 1e-3, 0.0], drive.odometry.xyt.shape)
    run = replace(drive, odometry=Trajectory(drive.odometry.stamps_ns, rough))
    brakes = user_effect("brakes", "along += abs(v) * (k * where(a < -0.3, 1, 0))", {"k": 0.3})
    model = MotionModel(NOISE, (brakes,))
    runs = [_drive(model, run)]
    fitted_m = _fitted_error(model, runs)
    assert fitted_m > 2.0 * _fitted_error(replace(model, effects=()), runs)
    assert _corrected_error((brakes,), model, runs) == pytest.approx(fitted_m, rel=0.01)
    monkeypatch.setattr(undo, "is_rough", lambda *_: False)
    assert _corrected_error((brakes,), model, runs) > 1.5 * fitted_m


@pytest.mark.slow
def test_a_learned_law_is_tested_at_the_recorded_speeds_themselves(drive):
    # corruption with a learned model may use the relative error of a lower speed; a law that needs it here is no law
    drive = replace(drive, odometry=drive.odometry.only(slice(1500)), truth=drive.truth.only(slice(1500)))
    stuck = user_effect("stuck", "along += -3 * v * k * max(abs(v) - 0.1, 0)", {"k": 1.0})
    model = MotionModel(NOISE, (stuck,), source={"recordings": ["a.mcap"]})
    assert np.isfinite(corrupted(model, drive)).all()
    found = verified_model(model, [drive])
    assert not found.model.effects
    assert "no odometry satisfies it" in found.changes[0]


TRACK_M = 0.4
STRENGTHS = {"usual": Coefficients(0.0105, 0.0087, 0.0018, 0.0005), "typical": Coefficients(0.05, 0.02, 0.05, 0.01)}


def corrupted_drive(strength, effects=(), seed=10):
    """Return what a simulator without noise records: the truth exactly, and odometry corrupted by this program."""
    steps = wander(seed, 250.0)
    clean = recording(steps, accumulate(np.zeros(3), steps), truth_mm=0.0, truth_rad=0.0, seed=seed)
    stamps, xyt = clean.odometry.stamps_ns, clean.odometry.xyt
    model = MotionModel(Noise("diffusion", STRENGTHS[strength]), tuple(effects), TRACK_M)
    odometry = xyt + NoisyPath(model, seed).feed(stamps, xyt).error_xyt
    return replace(clean, odometry=Trajectory(stamps, odometry), track_m=TRACK_M)


@pytest.mark.parametrize(("strength", "seed"), [("usual", 11), pytest.param("typical", 10, marks=pytest.mark.slow)])
def test_noise_alone_is_noise_alone(strength, seed):
    learned = learn([corrupted_drive(strength, seed=seed)])
    assert (learned.added, learned.laws, learned.unknown, learned.noise) == ((), (), (), ())
    k, put = learned.fit.noise.coefficients, STRENGTHS[strength]
    assert k.rot_trans == pytest.approx(put.rot_trans, rel=0.15)
    assert k.trans_trans == pytest.approx(put.trans_trans, rel=0.15)


@pytest.mark.slow
def test_an_effect_comes_back_with_its_size():
    learned = learn([corrupted_drive("usual", [effect_from_values("wheelbase", {"e": -0.03})])])
    assert (learned.added, learned.unknown, learned.noise) == (("wheelbase",), (), ())
    assert learned.fit.effects[0].e == pytest.approx(-0.03, abs=0.005)

"""Recordings of one robot share effects and noise, but not clocks, frames and truth noise."""

from dataclasses import replace

import numpy as np
import pytest
from wandering import noisy_path, recording, wander

from odomcorrupt.effects import effect_from_values
from odomcorrupt.geometry.se2 import Increments, accumulate, compose
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.motion_model import MotionModel, Noise, Setup, TruthNoise
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.estimate.calibrate import fit_robot
from odomcorrupt.study.validate.compare import compare

QUIET = Coefficients(0.01, 0.006, 0.008, 0.0)
WIDE, SCALE = 1.04, 1.02


def run_of(seed, *, truth_m, truth_rad, offset_s=0.0, frame=(0.0, 0.0, 0.0), seconds=240.0):
    """Return a drive of the robot whose odometry goes and turns too far, with a truth and a clock of its own."""
    steps = wander(seed, seconds)
    said = Increments(SCALE * steps.ds_m, steps.dl_m, WIDE * steps.dtheta_rad)
    run = recording(said, noisy_path(said, QUIET, seed), seed=seed)
    noise = np.random.default_rng(seed).normal(0.0, [truth_m, truth_m, truth_rad], (len(steps) + 1, 3))
    true = compose(np.array(frame), accumulate(np.zeros(3), steps)) + noise
    stamps = run.odometry.stamps_ns
    late = Trajectory(stamps + round(offset_s * 1e9), run.odometry.xyt)
    return replace(run, odometry=late, truth=Trajectory(stamps, true), origin_ns=int(late.stamps_ns[0]))


@pytest.fixture(scope="module")
def good():
    return run_of(1, truth_m=0.002, truth_rad=0.002, offset_s=0.04)


@pytest.fixture(scope="module")
def coarse():
    return run_of(2, truth_m=0.04, truth_rad=0.03, offset_s=-0.6, frame=(30.0, -12.0, 2.0))


@pytest.mark.slow
def test_a_coarse_truth_beside_a_good_one_neither_adds_noise_to_the_robot_nor_takes_its_information(good, coarse):
    effects = [effect_from_values(name, {}) for name in ("wheel_scale", "wheelbase")]
    alone, both = (fit_robot(runs, effects, law_name="diffusion") for runs in ([good], [good, coarse]))
    assert both.clocks.clocks[0].offset_s == pytest.approx(0.04, abs=0.005)
    assert both.clocks.clocks[1].offset_s == pytest.approx(-0.6, abs=0.05)
    found = {effect.name: effect for effect in both.model.effects}
    errors = both.model.standard_errors
    assert found["wheel_scale"].e == pytest.approx(1.0 / SCALE - 1.0, abs=4.0 * errors["wheel_scale.e"])
    for name in ("wheel_scale.e", "wheelbase.e"):
        assert errors[name] < 1.05 * alone.model.standard_errors[name]
    for name in ("rot_rot", "rot_trans", "trans_trans"):
        value, error = getattr(both.model.noise.coefficients, name), errors[name]
        assert value == pytest.approx(getattr(QUIET, name), abs=4.0 * error)
        # nodes lie as far apart as the coarse truth wants them
        assert error < 1.4 * alone.model.standard_errors[name]
    assert both.model.setup.truth.xy_m == pytest.approx(0.002, rel=0.2)


@pytest.mark.slow
def test_a_held_out_recording_is_judged_with_its_own_truth_and_a_clock_found_with_the_model_applied():
    """A robot that turns a third as far as its odometry says, and a clock that is 1.377 s behind."""
    runs = {}
    for name, offset_s in (("on time", 0.0), ("late", -1.377)):
        steps = wander(8, 200.0)
        said = Increments(steps.ds_m, steps.dl_m, 3.0 * steps.dtheta_rad)
        run = recording(said, noisy_path(said, QUIET, 8), seed=8)
        noise = np.random.default_rng(4).normal(0.0, [0.01, 0.01, 0.01], (len(steps) + 1, 3))
        true = Trajectory(run.odometry.stamps_ns, accumulate(np.zeros(3), steps) + noise)
        stamps = run.odometry.stamps_ns + round(offset_s * 1e9)
        odometry = Trajectory(stamps, run.odometry.xyt)
        runs[name] = replace(run, name=name, truth=true, odometry=odometry, origin_ns=int(stamps[0]))
    effect = effect_from_values("wheelbase", {"e": 2.0})
    model = MotionModel(Noise("diffusion", QUIET), (effect,), setup=Setup(truth=TruthNoise(0.001, 0.001, 0.0)))
    errors = {name: compare([run], {"model": model}) for name, run in runs.items()}
    assert errors["late"].clocks.clocks[0].offset_s == pytest.approx(-1.377, abs=0.03)
    on_time, late = (errors[name].evaluations[0].ten_second_error_m for name in ("on time", "late"))
    assert late < 1.1 * on_time
    for compared in errors.values():
        assert compared.evaluations[0].pieces[0].truth.xy_m == pytest.approx(0.01, rel=0.2)
        assert any("was weighted accordingly" in note for note in compared.evaluations[0].notes)

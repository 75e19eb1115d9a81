"""Clocks of recordings: estimated beside the model's effects, and no excuse for a wrong model."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import as_recording

from odomcorrupt.effects import effect_from_values
from odomcorrupt.model.motion_model import MotionModel
from odomcorrupt.model.presets import preset_named
from odomcorrupt.simulation import simulate
from odomcorrupt.study.estimate.calibrate import model_of
from odomcorrupt.study.estimate.clocks import Clocks, find_clocks
from odomcorrupt.study.estimate.config import choose_approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.io.clock import Clock
from odomcorrupt.study.validate.compare import compare
from odomcorrupt.study.validate.evaluation_clocks import clocks_beside

LATE_S = 0.06
"""How much later the truth is stamped than the odometry on the held-out drive."""


def drive(seed: int, late_s: float = 0.0):
    """Return three minutes of a robot with unequal wheels beside a total station, which measures positions only."""
    run = as_recording(simulate(seed, "unequal_wheels", duration_s=180.0, robot_seed=93), f"drive {seed}")
    return without_headings(run, late_s)


def without_headings(run, late_s=0.0):
    xyt = np.where([True, True, False], run.truth.xyt, np.nan)
    return replace(run, truth=replace(run.truth, xyt=xyt, stamps_ns=run.truth.stamps_ns + round(late_s * 1e9)))


@pytest.fixture(scope="module")
def right():
    run = drive(94)
    return model_of(fit([run], [effect_from_values("unequal_wheels", {})], approach=choose_approach([run])))


@pytest.fixture(scope="module")
def held():
    return drive(144, LATE_S)


def test_beside_a_truth_of_positions_the_clock_is_estimated_without_the_bends_of_the_model(right, held):
    found = clocks_beside([held], choose_approach([held]), right)
    assert abs(found.clocks[0].offset_s + LATE_S) < 0.002
    assert found.ranges_s[0][0] < -LATE_S < found.ranges_s[0][1]


@pytest.mark.slow
def test_a_right_model_is_rejected_for_an_error_of_the_clock_only_if_the_clock_is_known_better(right, held):
    at_s, wrong = 0.006 - LATE_S, {"without effects": replace(right, effects=())}
    found = {}
    for error_s, models in ((0.0005, {}), (0.004, wrong), (0.0, {})):
        near_s = ((at_s - 2 * error_s, at_s + 2 * error_s),) * (error_s > 0.0)
        clocks = Clocks((Clock(at_s),), ((True, False),), ((error_s or 0.004, 0.0),), ranges_s=near_s)
        *others, found[error_s] = compare([held], models | {"right": right}, clocks=clocks).evaluations
        assert all(one.verdict.fails for one in others)
    assert [one.verdict.fails for one in found.values()] == [True, False, True]
    moved = [any("clock offset changed by" in note for note in one.notes) for one in found.values()]
    assert moved[:2] == [False, True]
    assert len({(one.nats.per_m, one.nats.error, one.ten_second_error_m) for one in found.values()}) == 1


def test_slip_at_starts_and_stops_is_not_passed_off_as_a_clock():
    run = as_recording(simulate(93, "accel_slip", duration_s=180.0))
    fitted = fit([run], [effect_from_values("accel_slip", {})], approach=choose_approach([run]))
    bare = replace(model_of(fitted), effects=(), source={})
    assert compare([run], {"without effects": bare}).evaluations[0].verdict.fails


def test_an_effect_of_the_heading_in_the_world_is_taken_out_of_a_recording_whose_truth_has_none():
    recording = without_headings(as_recording(simulate(93, "slope", duration_s=60.0)))
    slope = effect_from_values("slope", {"creep": 0.01, "direction": 0.5})
    model = MotionModel(preset_named("typical").noise, effects=(slope,))
    clocks = clocks_beside([recording], choose_approach([recording]), model)
    assert abs(clocks.clocks[0].offset_s) < 0.05


def test_the_clock_of_a_laser_is_free_even_if_slip_pulls_it_to_where_it_increases_the_drift(monkeypatch):
    monkeypatch.setattr("odomcorrupt.study.estimate.clocks._harmless", lambda *_: False)
    recording = as_recording(simulate(93, "accel_slip", duration_s=120.0))
    approach = choose_approach([recording])
    assert find_clocks([recording], approach).free == ((False, False),)
    covariance = np.broadcast_to(np.diag([4e-6, 4e-6, 1e-5]), (len(recording.truth), 3, 3))
    seen = replace(recording, truth=replace(recording.truth, covariance=covariance), truth_scale_error=0.003)
    found = find_clocks([seen], approach)
    assert (found.free, found.clocks[0].offset_s) == (((True, False),), 0.0)

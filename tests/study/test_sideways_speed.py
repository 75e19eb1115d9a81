"""Errors over the sideways speed: tested on robots that drive sideways, and on no other."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import basis_dependences
from wandering import recording, wander

from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.expression import user_effect
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.estimate.regressors import driving_motion
from odomcorrupt.study.select.screening import CoarseDesign
from odomcorrupt.study.terms.term import BasisTerm

LOST = 0.04
"""Fraction of the sideways travel by which rollers that sag push a robot back."""


def sideways_drive(lost: float, seconds: float = 200.0):
    """Return a recording of a robot that drives forwards and sideways, and is pushed back as it drives sideways."""
    along, across = wander(1, seconds), wander(2, seconds)
    reported = Increments(along.ds_m, across.ds_m, along.dtheta_rad)
    slipped = 1e-3 * np.sqrt(np.hypot(along.ds_m, across.ds_m)) * np.random.default_rng(3).standard_normal(len(along))
    driven = replace(reported, ds_m=along.ds_m - lost * np.abs(across.ds_m) + slipped)
    return recording(driven, accumulate(np.zeros(3), reported), truth_mm=1.0, truth_rad=1e-3)


def fitted(run):
    return fit([run], approach=Approach())


def test_what_rollers_lose_sideways_is_an_error_over_the_sideways_speed():
    (found, *_) = basis_dependences(fitted(sideways_drive(LOST)))
    assert (found.channel, found.regressor, found.per) == ("along", "sideways_speed", "m")
    assert found.expression.startswith("along += abs(vy) * (-0.0")
    assert found.score.estimate[0] == pytest.approx(-LOST, rel=0.05)


def test_without_an_error_nothing_depends_on_the_sideways_speed():
    bare = fitted(sideways_drive(0.0))
    assert basis_dependences(bare) == []


def of_sideways(run):
    """Return the actions and basis functions of sideways motion that are tried on a recording."""
    design = CoarseDesign(fitted(run).problem)
    actions = {(a.target, a.move) for a in design.actions if "vy" in a.move}
    return actions, {f.text for f in design.functions if "vy" in f.text or f.regressor == "sideways_speed"}


def test_only_a_robot_that_can_and_does_drive_sideways_has_the_regressor():
    run = sideways_drive(0.0, 60.0)
    actions, functions = of_sideways(run)
    assert actions == {(channel, move) for channel in ("along", "across", "yaw") for move in ("vy", "abs(vy)")}
    assert {"k", "k * abs(vy)", "k * where(vy < -0.02, 1, 0)"} < functions
    assert of_sideways(replace(run, drive_type="differential")) == (set(), set())
    steps = wander(1, 60.0)
    unicycle = recording(steps, accumulate(np.zeros(3), steps))
    assert of_sideways(replace(unicycle, drive_type="omni")) == (set(), set())


def test_the_library_has_the_names_of_constant_errors_across_and_of_the_heading():
    design = CoarseDesign(fitted(sideways_drive(0.0, 60.0)).problem)
    constant = {(a.target, a.move) for a in design.actions if any(f.text == "k" for f in design.reaching(a))}
    assert constant == {("along", "vy"), ("along", "abs(vy)"), ("across", "abs(vy)"), ("yaw", "abs(vy)")}


def test_every_function_of_the_sideways_speed_says_in_its_expression_what_it_computes():
    run = sideways_drive(0.0, 60.0)
    design, motion = CoarseDesign(fitted(run).problem), driving_motion(run, "odometry")
    motion = replace(motion, vy=0.5 * np.sin(motion.t_s))  # long at no speed, so that few samples are at a threshold
    checked = 0
    for action in design.actions:
        for function in (f for f in design.reaching(action) if f.regressor == "sideways_speed"):
            checked += 1
            term = BasisTerm(function, action)
            ((_, rates),) = action.rates({"body": motion}, None)
            f = error_of(term.effect([0.3]), motion)
            # thresholds are written with four digits: a sample may fall between
            differs = np.abs(f + 0.3 * function.parts[0](motion)[:, None] * rates).max(axis=1) > 1e-3
            assert differs.mean() < 0.01, term.name
            assert np.allclose(error_of(user_effect("written", term.expression([0.3]), {}), motion), f, atol=1e-9)
    assert checked > 200

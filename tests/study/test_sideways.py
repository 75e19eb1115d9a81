"""Robots that drive sideways: slip of their rollers is named; other robots are not tested for it."""

from dataclasses import replace

import numpy as np
import pytest
from hidden import basis_dependences
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.design.identifiability import untried
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select.screening import CoarseDesign
from odomcorrupt.study.select.selection import learn

QUIET = Coefficients(0.004, 0.004, 0.008, 0.004)


@pytest.fixture(scope="module")
def drive():
    along = wander(311, 300.0)
    pace = np.arange(len(along)) / RATE_HZ
    return Increments(along.ds_m, 0.3 * np.sin(0.4 * pace) / RATE_HZ, along.dtheta_rad)


@pytest.mark.slow
def test_rollers_that_slip_have_a_name_and_the_right_size(drive):
    # the odometry says more than was driven: the truth is e = -6 % of it shorter
    reported = accumulate(np.zeros(3), Increments(drive.ds_m, drive.dl_m / 0.94, drive.dtheta_rad))
    learned = learn([recording(drive, reported, truth_mm=1.0, truth_rad=0.001, seed=311)])
    assert learned.added == ("sideways_scale",)
    assert learned.fit.effects[0].e == pytest.approx(-0.06, abs=0.002)
    assert learned.error_m < 0.1 * learned.rounds[0].candidates[0].rmse[0]


@pytest.mark.slow
def test_a_wheel_of_another_size_turns_the_robot_as_it_drives_sideways(drive):
    k = 0.05
    reported = accumulate(np.zeros(3), Increments(drive.ds_m, drive.dl_m, drive.dtheta_rad - k * drive.dl_m))
    learned = learn([recording(drive, reported, truth_mm=1.0, truth_rad=0.001, seed=313)])
    assert learned.added == ("sideways_turn",)
    assert learned.fit.effects[0].k == pytest.approx(k, abs=0.001)
    assert learned.error_m < 0.1 * learned.rounds[0].candidates[0].rmse[0]


def test_a_robot_that_cannot_is_not_asked_and_not_advised_to():
    steps = wander(312, 120.0)
    learned = learn([recording(steps, noisy_path(steps, QUIET, 312), seed=312)])
    assert learned.added == ()
    asked = {c.score.effect.name for c in learned.rounds[0].candidates} | {one.effect for one in untried(learned)}
    assert "region_slip" in asked
    assert asked.isdisjoint({"sideways_scale", "sideways_turn"})


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

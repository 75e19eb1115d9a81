"""Robots that drive sideways: slip of their rollers is named; other robots are not tested for it."""

import numpy as np
import pytest
from wandering import RATE_HZ, noisy_path, recording, wander

from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.model.noise_laws import Coefficients
from odomcorrupt.study.design.identifiability import untried
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
    told = accumulate(np.zeros(3), Increments(drive.ds_m, drive.dl_m / 0.94, drive.dtheta_rad))
    learned = learn([recording(drive, told, truth_mm=1.0, truth_rad=0.001, seed=311)])
    assert learned.added == ("sideways_scale",)
    assert learned.fit.effects[0].e == pytest.approx(-0.06, abs=0.002)
    assert learned.error_m < 0.1 * learned.rounds[0].candidates[0].rmse[0]


@pytest.mark.slow
def test_a_wheel_of_another_size_turns_the_robot_as_it_drives_sideways(drive):
    k = 0.05
    told = accumulate(np.zeros(3), Increments(drive.ds_m, drive.dl_m, drive.dtheta_rad - k * drive.dl_m))
    learned = learn([recording(drive, told, truth_mm=1.0, truth_rad=0.001, seed=313)])
    assert learned.added == ("sideways_turn",)
    assert learned.fit.effects[0].k == pytest.approx(k, abs=0.001)
    assert learned.error_m < 0.1 * learned.rounds[0].candidates[0].rmse[0]


def test_a_robot_that_cannot_is_not_asked_and_not_advised_to():
    steps = wander(312, 200.0)
    learned = learn([recording(steps, noisy_path(steps, QUIET, 312), seed=312)])
    assert learned.added == ()
    asked = {c.score.effect.name for c in learned.rounds[0].candidates} | {one.effect for one in untried(learned)}
    assert "region_slip" in asked
    assert asked.isdisjoint({"sideways_scale", "sideways_turn"})

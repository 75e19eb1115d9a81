"""A robot that only turns on the spot: no model of travel, and no traceback on its way."""

import numpy as np
import pytest
from wandering import RATE_HZ, recording, wander

import odomcorrupt as oc
from odomcorrupt.api.recordings import Recordings
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.estimate.gauss_newton import fit
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.select.random_effects import random_coefficients


def turning(noise_m=0.0, duration_s=36.0, travel_m=0.0):
    """Return a recording of turns to the left, 2 % too far, with noise of travel in each step of the odometry."""
    n = int(duration_s * RATE_HZ)
    along, none = np.full(n, travel_m / n), np.zeros(n)
    turns = np.full(n, 1.2 / RATE_HZ)
    noise = noise_m * np.random.default_rng(1).standard_normal(n)
    odometry = accumulate(np.zeros(3), Increments(along + noise, none, 1.02 * turns))
    return recording(Increments(along, none, turns), odometry)


@pytest.mark.parametrize("noise_m", [0.0, 0.003])
@pytest.mark.parametrize("study", [oc.learn, oc.fit, oc.diagnose])
def test_turns_alone_are_refused_in_one_line_whatever_the_truth(study, noise_m):
    with pytest.raises(RecordingError, match=r"travels 0\.\d\d m only, .*turns on the spot.*some metres") as refused:
        study(Recordings((turning(noise_m),), ()))
    assert "\n" not in str(refused.value)


def test_turns_beside_a_drive_that_travels_are_not_refused():
    steps = wander(3, 60.0)
    drive = recording(steps, accumulate(np.zeros(3), steps))
    assert oc.fit(Recordings((turning(0.003), drive), ())).model


def test_gains_of_travel_without_travel_are_tested_for_every_correlation_time():
    fitted = fit([turning()], approach=Approach())
    assert not np.concatenate([m.v for m in fitted.problem.motions]).any()
    assert "along" not in {getattr(one.effect, "channel", "") for one in random_coefficients(fitted, DECISIONS)}

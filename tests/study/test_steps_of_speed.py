"""Speeds truncated to steps are no ticks of encoders."""

import numpy as np
import pytest
from wandering import recording, wander

from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.io.encoders import encoder_effects, speeds_in_steps, tick_of

TRACK_M, DT_S = 0.36, 0.02


def reported(travel, turn):
    """Return a drive whose odometry has these increments."""
    steps = wander(3, 120.0)
    run = recording(steps, accumulate(np.zeros(3), steps), seed=3)
    xyt = accumulate(np.zeros(3), Increments(travel, np.zeros_like(travel), turn))
    return run.__class__(run.name, Trajectory(run.odometry.stamps_ns, xyt), run.truth, run.origin_ns, TRACK_M)


def speeds():
    steps = wander(3, 120.0)
    return steps.ds_m / DT_S, steps.dtheta_rad / DT_S


def test_truncated_speeds_are_no_ticks():
    v, omega = speeds()
    run = reported(0.04 * np.trunc(v / 0.04) * DT_S, 0.06 * np.trunc(omega / 0.06) * DT_S)
    assert speeds_in_steps(run)
    assert tick_of(run) is None
    assert not any(effect.name == "quantization" for effect in encoder_effects(run))


def test_ticks_of_two_wheels_are_no_steps_of_speed():
    v, omega = speeds()
    tick_m = 0.002
    right, left = (np.cumsum(v + side * omega * TRACK_M / 2.0) * DT_S for side in (1.0, -1.0))
    right, left = (np.diff(np.floor(way / tick_m) * tick_m, prepend=0.0) for way in (right, left))
    run = reported(0.5 * (right + left), (right - left) / TRACK_M)
    assert not speeds_in_steps(run)
    assert tick_of(run) == pytest.approx(tick_m, rel=0.01)

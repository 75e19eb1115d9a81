"""Rates of clocks are estimated within what clocks have."""

from __future__ import annotations

import numpy as np
import pytest

from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.estimate.clocks import find_clocks
from odomcorrupt.study.estimate.config import Approach
from odomcorrupt.study.io.recording import Recording


@pytest.mark.parametrize("rate", [5e-4, 0.02])
def test_a_rate_that_no_clock_has_is_not_taken_for_that_of_a_clock(rate):
    t_s = np.arange(0.0, 300.0, 0.05)
    speed, turn = 0.5 + 0.4 * np.sin(0.9 * t_s) * np.sin(0.13 * t_s), 0.6 * np.sin(0.7 * t_s)
    yaw = np.cumsum(turn) * 0.05
    path = np.column_stack((np.cumsum(speed * np.cos(yaw)) * 0.05, np.cumsum(speed * np.sin(yaw)) * 0.05, yaw))
    truth = path + np.random.default_rng(2).normal(0.0, 1e-3, path.shape)
    real, own = (np.round(one * 1e9).astype(np.int64) for one in (t_s, t_s * (1.0 + rate)))
    recording = Recording(
        name="run", odometry=Trajectory(own, path), truth=Trajectory(real, truth), origin_ns=0, track_m=None, notes=()
    )
    (clock,) = find_clocks([recording], Approach()).clocks
    assert clock.rate == (pytest.approx(rate, rel=0.05) if rate < 1e-3 else 0.0)

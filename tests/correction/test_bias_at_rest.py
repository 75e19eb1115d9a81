"""A gyro's bias that walks is read where the robot stands, and removed by `correct`."""

import numpy as np
import pytest

from odomcorrupt.correction.undo import undo_effects
from odomcorrupt.effects.gains import WheelScale
from odomcorrupt.effects.heading_sensors import GyroBias
from odomcorrupt.effects.random_processes import GyroBiasWalk
from odomcorrupt.geometry.se2 import Increments, accumulate

HZ = 50.0
LEG_S = 20.0
"""A leg is driven for all but its last 3 s, in which the robot stands."""


def drive(*, rests=True, slow_turn=False):
    """Return times (n,) and twists (n - 1, 2) of arcs with rests between them."""
    t_s = np.arange(round(600.0 * HZ) + 1) / HZ
    phase, leg = t_s[:-1] % LEG_S, (t_s[:-1] // LEG_S).astype(int)
    moves = (phase < LEG_S - 3.0) | (not rests)
    v = np.where(moves, 0.5, 0.0)
    omega = np.where(moves, 0.3 * np.cos(leg), 0.0)
    if slow_turn:
        omega = np.where(~moves & (leg == 14), 0.03, omega)
    return t_s, np.column_stack((v, omega))


def path(t_s, twist):
    steps = twist * np.diff(t_s)[:, None]
    return accumulate(np.zeros(3), Increments(steps[:, 0].copy(), np.zeros(len(steps)), steps[:, 1].copy()))


def walked(t_s, density, tau, seed=4):
    """Return a bias (n - 1,) that walks from .004 rad/s, with white noise of a gyro."""
    rng = np.random.default_rng(seed)
    keep = np.exp(-1.0 / HZ / tau) if tau else 1.0
    kick = density * np.sqrt(0.5 * tau * (1.0 - keep**2) if tau else 1.0 / HZ)
    bias = [0.004]
    for draw in rng.standard_normal(len(t_s) - 2):
        bias.append(keep * bias[-1] + kick * draw)
    return np.array(bias) + 1e-4 * np.sqrt(HZ) * rng.standard_normal(len(bias))


def heading_errors(effects, t_s, twist, bias):
    """Return the largest error of heading (rad) of the odometry, and after correction."""
    true = path(t_s, twist)
    odometry = path(t_s, twist + np.column_stack((np.zeros_like(bias), bias)))
    error = undo_effects(effects, t_s, odometry, 0.4).error_xyt
    return np.abs(odometry - true)[:, 2].max(), np.abs(odometry + error - true)[:, 2].max()


@pytest.mark.parametrize("tau", [0.0, 200.0])
def test_rests_show_the_bias(tau):
    t_s, twist = drive()
    walk = GyroBiasWalk(density=1e-4, tau=tau)
    before, after = heading_errors([walk], t_s, twist, walked(t_s, walk.density, tau))
    assert after < 0.05 * before


def test_a_constant_bias_in_the_model_is_removed_once():
    t_s, twist = drive()
    walk = GyroBiasWalk(density=1e-4)
    bias = walked(t_s, walk.density, 0.0)
    _, alone = heading_errors([walk], t_s, twist, bias)
    _, both = heading_errors([walk, GyroBias(bias=0.004)], t_s, twist, bias)
    assert both == pytest.approx(alone, rel=0.05)


def test_a_slow_turn_on_the_spot_is_no_bias():
    t_s, twist = drive(slow_turn=True)
    walk = GyroBiasWalk(density=1e-4)
    _, after = heading_errors([walk], t_s, twist, walked(t_s, walk.density, 0.0))
    assert after < 0.02  # it turns by 0.09


@pytest.mark.parametrize(("effects", "rests"), [([GyroBiasWalk(density=1e-4)], False), ([WheelScale(e=0.0)], True)])
def test_nothing_is_removed_without_rests_or_without_the_effect(effects, rests):
    t_s, twist = drive(rests=rests)
    before, after = heading_errors(effects, t_s, twist, walked(t_s, 1e-4, 0.0))
    assert after == before


def test_wheels_that_show_no_bias_at_rest_are_not_corrected():
    t_s, twist = drive()
    bias = np.where(twist[:, 0] == 0.0, 0.0, walked(t_s, 1e-4, 0.0))
    before, after = heading_errors([GyroBiasWalk(density=1e-4)], t_s, twist, bias)
    assert after == pytest.approx(before, rel=1e-9)

"""A compass deflected by iron on the robot: the error of the heading against an integrated differential equation."""

from __future__ import annotations

import numpy as np
import pytest
from manoeuvres import motion
from scipy.integrate import solve_ivp

from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.heading_sensors import HardIron

K, M, RATE_HZ = 0.1, -0.06, 50.0


def deflected(effect, omega):
    """Return the time (n,) at the end of each interval, and the heading's error there, of a robot that turns so."""
    drive = motion(0.0 * omega, omega, seconds=len(omega) / RATE_HZ)
    return np.cumsum(drive.dt_s), -np.cumsum(error_of(effect, drive)[:, 2] * drive.dt_s)


@pytest.mark.parametrize("tau", [0.5, 3.0])
def test_the_error_solves_the_equation_of_a_low_pass_filter(tau):
    omega = np.where(np.arange(1500) < 500, 0.7, np.where(np.arange(1500) < 800, 0.0, -1.1))
    t_s, error = deflected(HardIron(k=K, m=M, time_constant=tau), omega)
    begins_s, theta = np.append(0.0, t_s), np.append(0.0, np.cumsum(omega)) / RATE_HZ

    def change(t, d):
        heading = np.interp(t, begins_s, theta)
        return (K * np.cos(heading) + M * np.sin(heading) - d) / tau

    exact = solve_ivp(change, (0.0, t_s[-1]), [K], t_eval=t_s, max_step=0.02, rtol=1e-8, atol=1e-10).y[0]
    # the headings are those at the begin of an interval
    assert error == pytest.approx(exact - K, abs=0.13 / RATE_HZ / tau)


def test_without_a_filter_the_error_is_a_wave_over_the_heading():
    omega = np.append(np.full(500, 0.5), 0.0)
    _, error = deflected(HardIron(k=K, m=M), omega)
    assert error[-1] == pytest.approx(K * (np.cos(5.0) - 1.0) + M * np.sin(5.0), abs=1e-9)

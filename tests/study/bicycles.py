"""Recordings of a car, from a kinematic bicycle with a rear drive: nothing of the package but the recording's form.

The odometry integrates the wheel's travel and the steering angle that the driver sees, by the bicycle's formula; the
truth is the body, moved by what the wheel and the wheels ahead really do.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from odomcorrupt.study.io.recording import Recording, Trajectory

GRID_HZ, RATE_HZ = 200, 50
AXLES_M = 0.5
TRUTH_M, TRUTH_RAD = 0.002, 0.003


@dataclass(frozen=True)
class Flaw:
    """What is wrong with a car: steering ratio - 1, offset (rad) and lag (s), reference point (m), wheel - 1."""

    ratio: float = 0.0
    offset: float = 0.0
    lag_s: float = 0.0
    ahead_m: float = 0.0
    wheel: float = 0.0


def smooth(values, width_s):
    """Return values with corners rounded, as a rate limit does."""
    kernel = np.hanning(max(int(width_s * GRID_HZ), 3))
    return np.convolve(values, kernel / kernel.sum(), mode="same")


def commands(seed, seconds, *, steady=False):
    """Return speed (m/s) and steering angle (rad) on the grid: stops, two speeds, reverse, curves to both sides."""
    rng = np.random.default_rng(seed)
    n = int(seconds * GRID_HZ)
    v, angle = np.zeros(n), np.zeros(n)
    at = 0
    while at < n:
        span = int(rng.uniform(4.0, 9.0) * GRID_HZ)
        v[at : at + span] = 0.6 if steady else rng.choice([0.0, 0.4, 0.8, 1.1, -0.4], p=[0.16, 0.24, 0.24, 0.24, 0.12])
        at += span
    at = 0
    while at < n:
        span = int(rng.uniform(1.5, 5.0) * GRID_HZ)
        angle[at : at + span] = rng.choice([-0.33, -0.15, 0.0, 0.15, 0.33])
        at += span
    return smooth(v, 1.0), smooth(angle, 0.6)


def lagged(values, tau_s):
    """Return values behind a first-order lag."""
    if tau_s == 0.0:
        return values
    kept, state, out = np.exp(-1.0 / (GRID_HZ * tau_s)), values[0], np.empty_like(values)
    for i, value in enumerate(values):
        state = kept * state + (1.0 - kept) * value
        out[i] = state
    return out


def composed(ds, dl, dtheta):
    """Return poses of increments, by the mid-point rule."""
    theta = np.concatenate(([0.0], np.cumsum(dtheta)))
    middle = theta[:-1] + dtheta / 2.0
    x = np.concatenate(([0.0], np.cumsum(ds * np.cos(middle) - dl * np.sin(middle))))
    y = np.concatenate(([0.0], np.cumsum(ds * np.sin(middle) + dl * np.cos(middle))))
    return np.stack((x, y, theta), axis=1)


def car(seed, flaw=Flaw(), seconds=240.0):
    """Return the recording of a car: 50 Hz odometry and truth, chance on the ground by the way of the wheel."""
    rng = np.random.default_rng([seed, 1])
    v, seen = commands(seed, seconds)
    dt = 1.0 / GRID_HZ
    angle = lagged((1.0 + flaw.ratio) * seen, flaw.lag_s) + flaw.offset
    way = v * dt
    loose = np.sqrt(np.abs(way))
    true_way = (1.0 + flaw.wheel) * way + 0.002 * loose * rng.standard_normal(len(way))
    turn = true_way * np.tan(angle) / AXLES_M + 0.003 * loose * rng.standard_normal(len(way))
    truth = composed(true_way, np.zeros_like(way), turn)
    odometry = composed(way, np.zeros_like(way), way * np.tan(seen) / AXLES_M)
    c, s = np.cos(truth[:, 2]), np.sin(truth[:, 2])
    truth = truth + flaw.ahead_m * np.stack((c - 1.0, s, np.zeros_like(c)), axis=1)
    step = GRID_HZ // RATE_HZ
    stamps = 10**18 + (np.arange(len(truth)) * dt * 1e9).round().astype(np.int64)
    noisy = truth + rng.normal(size=truth.shape) * [TRUTH_M, TRUTH_M, TRUTH_RAD]
    return Recording(
        "car",
        Trajectory(stamps[::step], odometry[::step]),
        Trajectory(stamps[::step], noisy[::step]),
        int(stamps[0]),
    )

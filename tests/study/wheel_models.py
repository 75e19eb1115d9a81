"""Recordings of a car and of a hobby robot from wheel models that share only the Recording class with the package.

The car is a kinematic bicycle with a rear drive. Its odometry integrates the wheel's travel and the steering angle that
the driver sees; the truth is the body, moved by what the wheels really do. The hobby robot has two wheels: its odometry
integrates what is reported of each (a command, or counts), its truth what each really turns.
"""

from dataclasses import dataclass

import numpy as np

from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.io.recording import Recording

GRID_HZ, RATE_HZ = 200, 50
AXLES_M, HOBBY_TRACK_M = 0.5, 0.2
TRUTH_M, TRUTH_RAD = 0.002, 0.003


@dataclass(frozen=True)
class Flaw:
    """What is wrong with a car.

    ratio : of its steering, minus 1; offset (rad), lag_s and play_rad of its angle
    rate, stop : largest rate (rad/s) and lag (rad) of the wheels' angle behind the one that the driver sees
    ahead_m : of the point whose pose is recorded
    wheel : true over nominal travel, minus 1
    """

    ratio: float = 0.0
    offset: float = 0.0
    lag_s: float = 0.0
    ahead_m: float = 0.0
    wheel: float = 0.0
    play_rad: float = 0.0
    rate: float = np.inf
    stop: float = np.inf


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


def lagged(values, tau_s, rate=np.inf, stop=np.inf):
    """Return values behind a first-order lag, by at most `stop`, and that change by at most `rate` per second."""
    if tau_s == 0.0 and rate == np.inf:
        return values
    kept, most = np.exp(-1.0 / (GRID_HZ * tau_s)) if tau_s else 0.0, rate / GRID_HZ
    state, out = values[0], np.empty_like(values)
    for i, value in enumerate(values):
        state += min(max((1.0 - kept) * (value - state), -most), most)
        state = min(max(state, value - stop), value + stop)
        out[i] = state
    return out


def loose(values, play):
    """Return values that stay where they are until what they hang on has moved on by half a play."""
    at, out = values[0], np.empty_like(values)
    for i, value in enumerate(values):
        at = min(max(at, value - play / 2.0), value + play / 2.0)
        out[i] = at
    return out


def composed(ds, dtheta):
    """Return poses of increments, by the mid-point rule."""
    theta = np.concatenate(([0.0], np.cumsum(dtheta)))
    middle = theta[:-1] + dtheta / 2.0
    x = np.concatenate(([0.0], np.cumsum(ds * np.cos(middle))))
    y = np.concatenate(([0.0], np.cumsum(ds * np.sin(middle))))
    return np.stack((x, y, theta), axis=1)


def recorded(name, odometry, truth, rng):
    """Return a recording at 50 Hz of poses on the grid, the truth as cameras see it."""
    stamps = 10**18 + (np.arange(len(truth)) * 1e9 / GRID_HZ).round().astype(np.int64)
    noisy = truth + rng.normal(size=truth.shape) * [TRUTH_M, TRUTH_M, TRUTH_RAD]
    rows = slice(None, None, GRID_HZ // RATE_HZ)
    both = (Trajectory(stamps[rows], xyt[rows]) for xyt in (odometry, noisy))
    return Recording(name, *both, int(stamps[0]))


def bends(seed, seconds):
    """Return an angle (rad) as a planner's curves ask for it on the grid: of any size up to a third, no stop."""
    rng = np.random.default_rng([seed, 3])
    spans = rng.uniform(2.0, 5.0, int(seconds / 2.0))
    peaks = np.clip(rng.normal(0.0, 0.12, len(spans)), -0.33, 0.33)
    return np.interp(np.arange(int(seconds * GRID_HZ)) / GRID_HZ, np.cumsum(spans), peaks)


def car(seed, flaw=Flaw(), seconds=240.0, *, planned=False):
    """Return the recording of a car; chance is on the ground, by the way of the wheel.

    planned : whether it keeps to the curves of a planner and never steers up to a stop, as two driven wheels may, too
    """
    rng = np.random.default_rng([seed, 1])
    v, seen = commands(seed, seconds)
    seen = bends(seed, seconds) if planned else seen
    angle = loose(lagged((1.0 + flaw.ratio) * seen, flaw.lag_s, flaw.rate, flaw.stop), flaw.play_rad) + flaw.offset
    way = v / GRID_HZ
    root = np.sqrt(np.abs(way))
    true_way = (1.0 + flaw.wheel) * way + 0.002 * root * rng.standard_normal(len(way))
    turn = true_way * np.tan(angle) / AXLES_M + 0.003 * root * rng.standard_normal(len(way))
    truth = composed(true_way, turn)
    c, s = np.cos(truth[:, 2]), np.sin(truth[:, 2])
    truth = truth + flaw.ahead_m * np.stack((c - 1.0, s, np.zeros_like(c)), axis=1)
    return recorded("car", composed(way, way * np.tan(seen) / AXLES_M), truth, rng)


def forklift(seed, flaw=Flaw(), seconds=240.0):
    """Return the recording of a tricycle whose front wheel is steered, up to 57 degrees, driven and counted."""
    rng = np.random.default_rng([seed, 4])
    v, seen = commands(seed, seconds)
    seen = 3.0 * seen
    angle = (1.0 + flaw.ratio) * seen + flaw.offset
    way = v / GRID_HZ
    root = np.sqrt(np.abs(way))
    true_way = (1.0 + flaw.wheel) * way + 0.002 * root * rng.standard_normal(len(way))
    turn = true_way * np.sin(angle) / AXLES_M + 0.003 * root * rng.standard_normal(len(way))
    truth = composed(true_way * np.cos(angle), turn)
    return recorded("forklift", composed(way * np.cos(seen), way * np.sin(seen) / AXLES_M), truth, rng)


def hobby(seed, true_of, seconds=300.0, reported_of=None):
    """Return the recording of a robot with two wheels: straights, curves, turns on the spot, reverse, several speeds.

    true_of : rim speeds (n,) that are really reached, of those commanded and the time, s, of one wheel
    reported_of : the same of what odometry takes them for; the commanded ones without it
    """
    rng = np.random.default_rng([seed, 2])
    n = int(seconds * GRID_HZ)
    v, omega = np.zeros(n), np.zeros(n)
    at = 0
    while at < n:
        span = int(rng.uniform(2.5, 6.0) * GRID_HZ)
        kind = rng.choice(5, p=[0.12, 0.34, 0.24, 0.18, 0.12])
        speed = rng.choice([0.05, 0.1, 0.18, 0.3])
        v[at : at + span] = (0.0, speed, speed, 0.0, -speed)[kind]
        omega[at : at + span] = (0.0, 0.0, *rng.uniform(-1.0, 1.0, 1), rng.choice([-1.5, -0.7, 0.7, 1.5]), 0.0)[kind]
        at += span
    v, omega = smooth(v, 0.5), smooth(omega, 0.5)
    t_s = np.arange(n) / GRID_HZ
    sides = [v + side * HOBBY_TRACK_M / 2.0 * omega for side in (1.0, -1.0)]
    true = [true_of(u, t_s) for u in sides]
    true = [u / GRID_HZ + 0.0015 * np.sqrt(np.abs(u) / GRID_HZ) * rng.standard_normal(n) for u in true]
    seen = [(u if reported_of is None else reported_of(u, t_s)) / GRID_HZ for u in sides]
    truth, odometry = (composed((u[0] + u[1]) / 2.0, (u[0] - u[1]) / HOBBY_TRACK_M) for u in (true, seen))
    return recorded("hobby", odometry, truth, rng)

"""Drives for tests of the study: a unicycle that wanders through an office, and recordings of it."""

from dataclasses import replace

import numpy as np

from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.model.noise_laws import Coefficients, law_named, variances
from odomcorrupt.study.io.recording import Recording

RATE_HZ = 50.0
QUIET = Coefficients(0.004, 0.004, 0.002, 0.001)
PLANTED = Coefficients(0.05, 0.02, 0.05, 0.01)


def wander(seed: int, duration_s: float = 600.0) -> Increments:
    """Return smooth speeds with stops, reverses, spot turns and curves, as increments at 50 Hz."""
    rng = np.random.default_rng((1, seed))
    n = int(duration_s * RATE_HZ)
    v, omega = np.zeros(n), np.zeros(n)
    i = 0
    while i < n:
        length = int(rng.uniform(2.0, 8.0) * RATE_HZ)
        kind = rng.random()
        if kind < 0.12:
            speeds = 0.0, 0.0
        elif kind < 0.2:
            speeds = -rng.uniform(0.1, 0.4), rng.uniform(-0.3, 0.3)
        elif kind < 0.3:
            speeds = 0.0, rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1.0)
        elif kind < 0.6:
            speeds = rng.uniform(0.2, 1.2), 0.0
        else:
            speeds = rng.uniform(0.2, 1.0), rng.uniform(-0.7, 0.7)
        v[i : i + length], omega[i : i + length] = speeds
        i += length
    window = np.ones(int(0.6 * RATE_HZ)) / int(0.6 * RATE_HZ)
    v, omega = np.convolve(v, window, "same"), np.convolve(omega, window, "same")
    return Increments(v / RATE_HZ, np.zeros(n), omega / RATE_HZ)


def noisy_path(steps: Increments, k: Coefficients, seed: int) -> np.ndarray:
    """Return odometry poses made noisy by the textbook, one step after the other."""
    rng = np.random.default_rng((2, seed))
    v = variances(law_named("diffusion"), k, steps)
    e1, et, e2 = rng.standard_normal((3, len(steps))) * np.sqrt(np.stack((v.rot1, v.trans, v.rot2)))
    x = y = theta = 0.0
    poses = [(x, y, theta)]
    for ds, dtheta, a, t, b in zip(steps.ds_m, steps.dtheta_rad, e1, et, e2, strict=True):
        heading = theta + a + dtheta / 2.0
        x += (ds + t) * np.cos(heading)
        y += (ds + t) * np.sin(heading)
        theta += a + dtheta + b
        poses.append((x, y, theta))
    return np.array(poses)


def recording(
    steps: Increments, odometry_xyt: np.ndarray, *, truth_mm: float = 3.0, truth_rad: float = 0.003, seed: int = 0
) -> Recording:
    """Return a recording with a noisy truth of the clean drive."""
    rng = np.random.default_rng((3, seed))
    truth = accumulate(np.zeros(3), steps)
    truth = truth + rng.standard_normal(truth.shape) * [truth_mm * 1e-3, truth_mm * 1e-3, truth_rad]
    stamps = (np.arange(len(truth)) * 1e9 / RATE_HZ).astype(np.int64) + 1_700_000_000_000_000_000
    return Recording(f"drive {seed}", Trajectory(stamps, odometry_xyt), Trajectory(stamps, truth), int(stamps[0]))


def drive(seed, seconds=240.0, noise=QUIET, *, said=None, driven=None, **truth):
    """Return a recording of a wandering robot.

    said, driven : of the planned steps, those that odometry reports before its noise, and those that the robot makes
    truth : options of `recording`
    """
    steps = wander(seed, seconds)
    reported, true = (change(steps) if change else steps for change in (said, driven))
    return recording(true, noisy_path(reported, noise, seed), seed=seed, **truth)


def late(run, offset_s, rate=0.0):
    """Return the recording with stamps of the odometry that are later, by so much at its start."""
    since_ns = run.odometry.stamps_ns - run.origin_ns
    stamps = run.odometry.stamps_ns + np.round(offset_s * 1e9 + rate * since_ns).astype(np.int64)
    return replace(run, odometry=replace(run.odometry, stamps_ns=stamps), origin_ns=int(stamps[0]))


def positions_only(run, every=1):
    """Return the recording with one of so many positions of its truth, and none of its headings."""
    truth = run.truth.only(slice(None, None, every))
    return replace(run, truth=replace(truth, xyt=np.where([True, True, False], truth.xyt, np.nan)))


def slewed(slips, degrees):
    """Return what turns the steps by so much within a second from each of these times, s."""

    def turned(steps):
        more = np.zeros(len(steps))
        for at in slips:
            more[at * 50 : at * 50 + 50] = np.radians(degrees) / 50.0
        return replace(steps, dtheta_rad=steps.dtheta_rad + more)

    return turned


def scaled(travel=1.0, turn=1.0):
    return lambda steps: Increments(travel * steps.ds_m, travel * steps.dl_m, turn * steps.dtheta_rad)

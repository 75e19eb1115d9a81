"""A gyro's bias, read from the odometry while the robot stands: a zero-velocity update.

Source: Foxlin 2005, Pedestrian tracking with shoe-mounted inertial sensors (zero-velocity updates); Rauch, Tung and
Striebel 1965 (smoother).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.effects.random_processes import GyroBiasWalk

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect, Motion
    from odomcorrupt.geometry.se2 import Array

STILL_MPS = 1e-3
"""Speed below which wheels stand, m/s: less than a tick of usual encoders per message."""
TURNING_RADPS = 0.05
"""Yaw rate beyond which a robot without travel turns on the spot; the bias of a MEMS gyro is below 0.02 rad/s."""
REST_S, SETTLED_S = 0.6, 0.15
"""Shortest rest that is read, and the part at either end that is left out, because the body sways on its wheels."""
_START_RADPS = 0.05
"""Standard deviation of the bias before its first reading."""
_OUTLIER = 5.0
"""Difference from the neighbouring readings, in standard deviations, beyond which a robot turned slowly instead."""


class Readings(NamedTuple):
    """Mean yaw rates (k,) of k rests, rad/s, with their variances, at times (k,) after the start, s."""

    rate: Array
    variance: Array
    t_s: Array


def bias_seen_at_rest(effects: Sequence[Effect], motion: Motion, omega: Array) -> Array:
    """Return the gyro's bias (n,), rad/s: read in rests, smoothed as a `gyro_bias_walk` between them; zero without one.

    effects : of the model
    motion : of the odometry, n intervals
    omega : (n,) yaw rates after the removal of systematic effects, rad/s
    """
    walk = next((effect for effect in effects if isinstance(effect, GyroBiasWalk) and effect.acts), None)
    readings = _readings(motion, omega)
    if walk is None or not len(readings.t_s):
        return np.zeros(len(motion))
    readings = _without_turns(walk, readings)
    return _between(walk, readings.t_s, _smoothed(walk, readings), np.cumsum(motion.dt_s) - motion.dt_s / 2.0)


def _readings(motion: Motion, omega: Array) -> Readings:
    """Return the mean yaw rate of each rest."""
    still = np.hypot(motion.v, motion.vy) < STILL_MPS
    still &= (np.abs(omega) < TURNING_RADPS) & (motion.dt_s > 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False])).astype(int)))
    ends_s = np.concatenate(([0.0], np.cumsum(motion.dt_s)))
    found = []
    for first, last in edges.reshape(-1, 2).tolist():
        begin_s, end_s = ends_s[first], ends_s[last]
        if end_s - begin_s < REST_S:
            continue
        inner = slice(*np.searchsorted(ends_s, (begin_s + SETTLED_S, end_s - SETTLED_S)).tolist())
        rates, dt_s = omega[inner], motion.dt_s[inner]
        if len(rates) > 1:
            found.append((np.average(rates, weights=dt_s), np.var(rates) / len(rates), (begin_s + end_s) / 2.0))
    return Readings(*np.array(found).reshape(-1, 3).T)


def _without_turns(walk: GyroBiasWalk, readings: Readings) -> Readings:
    """Return the readings without those that differ from what both neighbours predict: slow turns on the spot."""
    if len(readings.t_s) < 3:
        return readings
    rate, variance, t_s = readings
    before, after = np.diff(t_s)[:-1], np.diff(t_s)[1:]
    share = after / (before + after)  # of the earlier neighbour
    predicted = share * rate[:-2] + (1.0 - share) * rate[2:]
    bridge = walk.density**2 * before * after / (before + after)
    allowed = variance[1:-1] + share**2 * variance[:-2] + (1.0 - share) ** 2 * variance[2:] + bridge
    off = np.concatenate(([0.0], (rate[1:-1] - predicted) ** 2 / np.maximum(allowed, 1e-18), [0.0]))
    most = np.maximum(np.concatenate((off[1:], [0.0])), np.concatenate(([0.0], off[:-1])))
    kept = (off <= _OUTLIER**2) | (off < most)
    return Readings(rate[kept], variance[kept], t_s[kept])


def _smoothed(walk: GyroBiasWalk, readings: Readings) -> Array:
    """Return the expected bias (k,) at each reading, given all of them."""
    keep, kick = walk.kept(np.diff(readings.t_s))
    means, variances, predicted = [], [], []
    mean, variance = 0.0, _START_RADPS**2
    for i, (rate, noise) in enumerate(zip(readings.rate.tolist(), readings.variance.tolist(), strict=True)):
        if i:
            mean, variance = keep[i - 1] * mean, keep[i - 1] ** 2 * variance + kick[i - 1]
        predicted.append((mean, variance))
        gain = variance / (variance + noise)
        mean, variance = mean + gain * (rate - mean), (1.0 - gain) * variance
        means.append(mean)
        variances.append(variance)
    for i in range(len(means) - 2, -1, -1):
        ahead, spread = predicted[i + 1]
        if spread > 0.0:
            means[i] += variances[i] * keep[i] / spread * (means[i + 1] - ahead)
    return np.array(means)


def _between(walk: GyroBiasWalk, t_s: Array, bias: Array, at_s: Array) -> Array:
    """Return the expected bias (n,) at times (n,), given that (k,) at the readings (k,)."""
    if not walk.tau:
        return np.interp(at_s, t_s, bias)
    after = np.searchsorted(t_s, at_s)
    low, high = np.maximum(after - 1, 0), np.minimum(after, len(t_s) - 1)
    since, until = (np.exp(-np.abs(at_s - t_s[side]) / walk.tau) for side in (low, high))
    whole = np.exp(-np.maximum(t_s[high] - t_s[low], 1e-9) / walk.tau)
    inside = (since * (1.0 - until**2) * bias[low] + until * (1.0 - since**2) * bias[high]) / (1.0 - whole**2)
    return np.where(low == high, since * bias[low], inside)

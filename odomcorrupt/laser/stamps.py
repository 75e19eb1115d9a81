"""How noisy a laser's poses are: the level of what matches say, and the jitter of the sweeps' stamps.

With e the laser's heading minus the odometry's at the same time, white errors of the laser make neighbouring
differences of e anticorrelated, whatever the odometry does: cov(e1 - e0, e2 - e1) = -var. The part of that variance
which grows with the square of the yaw rate is jitter of the stamps.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.geometry.se2 import between, wrap

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.laser.calibrate import Motion
    from odomcorrupt.laser.trajectory import LaserPath

__all__ = ["WhiteNoise", "white_noise", "with_noise", "without_spikes"]

_FEW = 60
_EXTREME = 99.0
_GAP = 1.6
_TURNS_RADPS = 0.1
_LEAST_S = 1e-3
_LARGEST = 400.0
_SPIKE = 6.0
_USUAL = np.array([2.5e-3, 2.5e-3, 2e-3])


class WhiteNoise(NamedTuple):
    """Variance of headings over what matches say of it, and standard deviation of the stamps, seconds."""

    factor: float
    stamps_s: float


def white_noise(path: LaserPath, motion: Motion) -> WhiteNoise:
    """Return how noisy the poses of a path are beyond what their matches say; no jitter where it does not show."""
    t_s = path.t_s
    if len(t_s) < _FEW:
        return WhiteNoise(1.0, 0.0)
    away = path.xyt[:, 2] - np.unwrap(motion.robot(t_s)[:, 2])
    step = wrap(np.diff(away))
    apart = np.diff(t_s)
    whole = apart < _GAP * float(np.median(apart))
    both = whole[:-1] & whole[1:] & (path.part[:-2] == path.part[2:])
    white = -(step[:-1] * step[1:])[both]
    if len(white) < _FEW:
        return WhiteNoise(1.0, 0.0)
    white = np.clip(white, *np.percentile(white, (100.0 - _EXTREME, _EXTREME)))
    claimed = path.covariance[1:-1, 2, 2][both]
    square = (_rate(path, motion)[1:-1, 2] ** 2)[both]
    columns = np.stack((claimed, square), axis=1)
    turning = bool(np.sqrt(np.mean(square)) > _TURNS_RADPS)
    used = columns if turning else columns[:, :1]
    scale = np.sqrt(np.mean(used**2, axis=0))
    solution = np.linalg.lstsq(used / scale, white, rcond=None)[0] / scale
    residual = white - used @ solution
    error = np.sqrt(np.diag(np.linalg.pinv((used / scale).T @ (used / scale)))) / scale * float(np.std(residual))
    jitter = float(np.sqrt(max(solution[1], 0.0))) if turning and solution[1] > 2.0 * error[1] else 0.0
    factor = float(np.clip(solution[0], 1.0, _LARGEST))
    return WhiteNoise(factor, jitter if jitter > _LEAST_S else 0.0)


def with_noise(path: LaserPath, motion: Motion, noise: WhiteNoise) -> LaserPath:
    """Return the path with covariances of that level, and with what jitter of its stamps does to each pose."""
    covariance = path.covariance * noise.factor
    if noise.stamps_s > 0.0:
        rate = _rate(path, motion)
        covariance = covariance + noise.stamps_s**2 * rate[:, :, None] * rate[:, None, :]
    return replace(path, covariance=covariance)


def without_spikes(path: LaserPath, motion: Motion) -> LaserPath:
    """Return the path without poses that lie aside of their neighbours on both sides, by the odometry between them."""
    if len(path) < _FEW:
        return path
    robot = motion.robot(path.t_s)
    miss = between(path.xyt[:-1], path.xyt[1:]) - between(robot[:-1], robot[1:])
    miss[:, 2] = wrap(miss[:, 2])
    aside = 0.5 * np.abs(miss[:-1] - miss[1:])
    unseen = path.weak[1:-1]
    usual = 1.4826 * np.median(aside[~unseen] if (~unseen).any() else aside, axis=0)
    out = aside > _SPIKE * np.maximum(usual, _USUAL)
    out[unseen, :2] = False
    kept = np.ones(len(path), dtype=bool)
    kept[1:-1] = ~out.any(axis=1)
    return path.only(kept)


def _rate(path: LaserPath, motion: Motion) -> Array:
    """Return the robot's twist (k, 3) in its own axes at the sweeps, m/s and rad/s."""
    half = 0.05
    return between(motion.robot(path.t_s - half), motion.robot(path.t_s + half)) / (2.0 * half)

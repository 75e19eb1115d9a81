"""Clock offset and rate of the odometry relative to the truth: stamp = t + offset + rate t, t from the origin.

Clocks are estimated first: an unmodelled offset of 30 ms looks like slip or backlash and inflates every coefficient.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import theilslopes

from odomcorrupt.geometry.motion import slopes
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.io.headings import with_headings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Recording

_GRID_S = 0.05  # step of the lags
_SMOOTHING_S = 0.4
_REACH_S = 3.0  # largest lag
_STRETCH_S = 40.0  # shortest part of a run that is matched on its own
_MOVING = 0.1  # m/s; below it, a course has no usable rate


@dataclass(frozen=True, slots=True)
class Clock:
    """Clock of one recording; offset_s as in the effect `time_offset`, rate (s/s) as in `clock_skew`."""

    offset_s: float = 0.0
    rate: float = 0.0


def aligned(recording: Recording, clock: Clock) -> Recording:
    """Return the recording with the odometry's stamps converted to the truth's clock, in whole nanoseconds.

    A truth without headings gets them here, because they depend on the clock.
    """
    t_ns = recording.odometry.stamps_ns - recording.origin_ns
    shift = (clock.offset_s * 1e9 + clock.rate * t_ns) / (1.0 + clock.rate)
    stamps = recording.odometry.stamps_ns - np.round(shift).astype(np.int64)
    return with_headings(recording.with_odometry(Trajectory(stamps, recording.odometry.xyt)))


def clock_leaders(recordings: Sequence[Recording]) -> list[int]:
    """Return for each recording the index of the first recording with the same clock."""
    first: dict[str, int] = {}
    return [first.setdefault(recording.clock, i) if recording.clock else i for i, recording in enumerate(recordings)]


def led(free: Array, leaders: Sequence[int]) -> Array:
    """Return the mask (R, 2) of free clock parameters with a shared clock left free in its first recording only."""
    return free & (np.array(leaders) == np.arange(len(leaders)))[:, None]


def coarse_clock(recording: Recording) -> Clock:
    """Return initial clock values, accurate to about 0.1 s, from matched speeds and yaw rates.

    Parts of the run are matched separately at lags within +- 3 s; a Theil-Sen line fits their lags.
    """
    odo_s, truth_s = recording.odometry_s, recording.truth_s
    grid = np.arange(max(odo_s[0], truth_s[0]) + _REACH_S, min(odo_s[-1], truth_s[-1]) - _REACH_S, _GRID_S)
    reach = round(_REACH_S / _GRID_S)
    count = int(np.clip(len(grid) * _GRID_S // _STRETCH_S, 1, 12))
    if len(grid) < 4 * reach:
        return Clock()
    wide = grid[0] + _GRID_S * np.arange(-reach, len(grid) + reach)
    odometry = _speeds(odo_s, recording.odometry.xyt, wide)
    truth = _speeds(truth_s, recording.truth.xyt, grid)
    times, lags = [], []
    for part in np.array_split(np.arange(len(grid)), count):
        score = _correlation(odometry[part[0] : part[-1] + 2 * reach + 1], truth[part])
        best = int(np.argmax(score))
        if score[best] > 0.5 and 0 < best < 2 * reach:
            times.append(grid[part].mean())
            lags.append((best - reach) * _GRID_S)
    if not times:
        return Clock()
    if len(times) < 4:
        return Clock(float(np.median(lags)))
    line = theilslopes(lags, times)
    return Clock(float(line.intercept), float(line.slope))


def _speeds(t_s: Array, xyt: Array, at_s: Array) -> Array:
    """Return speed and yaw rate (m, 2), each divided by its root mean square."""
    world = slopes(t_s, xyt, at_s, _SMOOTHING_S)
    speed = np.linalg.norm(world[:, :2], axis=1)
    turn = world[:, 2] if np.isfinite(xyt[:, 2]).all() else _course_rate(world[:, :2], at_s)
    both = np.stack((speed, turn), axis=1)
    return both / np.maximum(np.sqrt(np.mean(both**2, axis=0)), 1e-6)


def _course_rate(velocity: Array, at_s: Array) -> Array:
    """Return the rate of the direction of travel (m,), rad/s; zero below 0.1 m/s."""
    course = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]), period=np.pi)
    rate: Array = slopes(at_s, course[:, None], at_s, _SMOOTHING_S)[:, 0]
    return np.where(np.linalg.norm(velocity, axis=1) > _MOVING, rate, 0.0)


def _correlation(a: Array, b: Array) -> Array:
    """Return the correlation (m + 1,) of b (n, c) with each window of length n of a (n + m, c)."""
    n, b = len(b), b - b.mean(axis=0)
    running = np.concatenate((np.zeros((1, 2, a.shape[1])), np.cumsum(np.stack((a, a**2), axis=1), axis=0)))
    total, square = np.moveaxis(running[n:] - running[:-n], 1, 0)
    common = sum(np.correlate(x, y, "valid") for x, y in zip(a.T, b.T, strict=True))
    spread = np.maximum(np.sum(square - total**2 / n, axis=1), 0.0) * np.sum(b**2)
    return common / np.maximum(np.sqrt(spread), 1e-12)

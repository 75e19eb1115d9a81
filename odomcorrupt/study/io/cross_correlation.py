"""Cross-correlation of two motions over lags; independent of their frames and clocks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.geometry.motion import slopes

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory

_SMOOTHING_S = 0.5
_MAX_GRID = 200_000  # grid points
_MAX_RADPS = 3.0  # rad/s at which yaw rates are clipped
_GAP_S = 5.0
"""Longer gaps between poses (outages, unresolved fixes) are excluded: interpolation does not show the motion there."""
_SIDEWAYS_RADPS = 0.03
"""Yaw rate (rad/s, root mean square) below which a robot counts as moving sideways instead of turning."""


class Spread(NamedTuple):
    """Standard deviations of yaw rate and of speed, and the root mean square of the speed."""

    turn_radps: float
    speed_mps: float
    level_mps: float


@dataclass(frozen=True, slots=True)
class CrossCorrelation:
    """Correlations of speed and of yaw rate at each lag.

    lag_s : (k,) shift of the truth to later times, seconds
    speed, turn : (k,) correlations of speeds and of yaw rates, -1 to 1
    odometry, truth : spread of speed and yaw rate in each of them
    """

    lag_s: Array
    speed: Array
    turn: Array
    odometry: Spread
    truth: Spread

    @property
    def both(self) -> Array:
        """Mean of both correlations (k,)."""
        return (self.turn + self.speed) / 2.0

    @property
    def mirrored(self) -> Array:
        """Mean of both correlations (k,) with the sign of the truth's yaw rate reversed."""
        return (self.speed - self.turn) / 2.0


def cross_correlation(
    odometry: Trajectory,
    truth: Trajectory,
    reach_s: float,
    *,
    from_start: bool = False,
    smoothing_s: float = _SMOOTHING_S,
) -> CrossCorrelation:
    """Return the correlations of speeds and yaw rates of odometry and truth at lags from -reach_s to reach_s.

    from_start : measure each time from its own first stamp instead of comparing absolute stamps
    smoothing_s : time over which speeds and yaw rates are averaged
    """
    origin = int(odometry.stamps_ns[0])
    a_s = odometry.seconds_since(origin)
    b_s = truth.seconds_since(int(truth.stamps_ns[0]) if from_start else origin)
    if not from_start:
        first, last = max(a_s[0], b_s[0]) - reach_s, min(a_s[-1], b_s[-1]) + reach_s
    else:
        first, last = 0.0, max(a_s[-1], b_s[-1])
    step = max(0.1, (last - first) / _MAX_GRID)
    grid = np.arange(first, last, step)
    turned = np.sqrt(np.mean(slopes(a_s, odometry.xyt[:, 2:], grid, smoothing_s) ** 2))
    by_course = bool(np.isnan(truth.xyt[:, 2]).all()) or turned < _SIDEWAYS_RADPS
    one, other = (
        _signals(t, path.xyt, grid, smoothing_s, by_course=by_course) for t, path in ((a_s, odometry), (b_s, truth))
    )
    count = min(round(reach_s / step), len(grid) - 1)
    turn, speed = (_correlation(one[:, i], other[:, i], count) for i in (0, 1))
    return CrossCorrelation(
        lag_s=np.arange(-count, count + 1) * step,
        speed=speed,
        turn=turn,
        odometry=_spread(one),
        truth=_spread(other),
    )


def _spread(signals: Array) -> Spread:
    there = signals[np.isfinite(signals).all(axis=1)]
    turn, speed = there.std(axis=0).tolist()
    return Spread(turn, speed, float(np.sqrt(np.mean(there[:, 1] ** 2))))


def _signals(t_s: Array, xyt: Array, grid: Array, smoothing_s: float, *, by_course: bool) -> Array:
    """Return yaw rate and speed (m, 2) on a grid, NaN outside the path; yaw rates from courses if `by_course`."""
    world = slopes(t_s, xyt[:, :2], grid, smoothing_s)
    speed = np.linalg.norm(world, axis=1)
    if by_course:
        # Doubled courses are the same for forward and backward driving.
        course = 2.0 * np.arctan2(world[:, 1], world[:, 0])
        turn = np.gradient(np.unwrap(course), grid) / 2.0
        turn[speed < 0.3 * np.sqrt(np.mean(speed**2))] = 0.0
    else:
        turn = slopes(t_s, xyt[:, 2:], grid, smoothing_s)[:, 0]
    out = np.stack((np.clip(turn, -_MAX_RADPS, _MAX_RADPS), speed), axis=1)
    out[:, 1] = np.minimum(out[:, 1], 1.5 * np.percentile(speed, 95.0))
    unseen = (grid < t_s[0]) | (grid > t_s[-1])
    for gap in np.flatnonzero(np.diff(t_s) > _GAP_S):
        unseen |= (grid > t_s[gap] - 0.5 * smoothing_s) & (grid < t_s[gap + 1] + 0.5 * smoothing_s)
    out[unseen] = np.nan
    return out


def _correlation(a: Array, b: Array, count: int) -> Array:
    """Return the correlations (2 count + 1,) of a at i + lag with b at i, over samples where both are finite."""
    size = 1 << int(np.ceil(np.log2(2 * len(a))))
    there_a, there_b = np.isfinite(a).astype(np.float64), np.isfinite(b).astype(np.float64)
    a, b = np.where(there_a > 0, a, 0.0), np.where(there_b > 0, b, 0.0)

    def shifted(x: Array, y: Array) -> Array:
        whole = np.fft.irfft(np.fft.rfft(x, size) * np.conj(np.fft.rfft(y, size)), size)
        return np.concatenate((whole[-count:] if count else whole[:0], whole[: count + 1]))

    n = np.maximum(shifted(there_a, there_b), 1.0)
    mean_a, mean_b = shifted(a, there_b) / n, shifted(there_a, b) / n
    cross = shifted(a, b) / n - mean_a * mean_b
    var_a = shifted(a * a, there_b) / n - mean_a**2
    var_b = shifted(there_a, b * b) / n - mean_b**2
    scale = np.sqrt(np.maximum(var_a, 1e-9) * np.maximum(var_b, 1e-9))
    # With little overlap, correlations are high by chance.
    return np.where(n > 0.3 * n.max(), cross / scale, 0.0)

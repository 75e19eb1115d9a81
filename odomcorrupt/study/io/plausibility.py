"""Plausibility checks of odometry and truth as one run, before any computation.

Motions are compared by the cross-correlation of speeds and yaw rates over lags, which is independent of their frames.
Only clear mismatches are refused: the better of the two correlations is at least 0.6 in 19 recordings by others, and at
most 0.4 between different drives of some minutes.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.signal import correlate

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.motion import slopes
from odomcorrupt.study.io.raw_trajectory import CLOCK_S, FEWEST

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.study.io.raw_trajectory import Samples


_SMOOTHING_S = 0.5
_MAX_GRID = 200_000  # grid points
_MAX_RADPS = 3.0  # rad/s at which yaw rates are clipped
_GAP_S = 5.0
"""Longer gaps between poses (outages, unresolved fixes) are excluded: interpolation does not show the motion there."""
_SIDEWAYS_RADPS = 0.03
"""Yaw rate (rad/s, root mean square) below which a robot counts as moving sideways instead of turning."""


@dataclass(frozen=True, slots=True)
class CrossCorrelation:
    """Correlations of speed and of yaw rate at each lag.

    lag_s : (k,) shift of the truth to later times, seconds
    speed, turn : (k,) correlations of speeds and of yaw rates, -1 to 1
    varies : whether the speeds or the yaw rates of both vary more than noise may
    """

    lag_s: Array
    speed: Array
    turn: Array
    varies: bool

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
    pair = (a_s, odometry.xyt), (b_s, truth.xyt)
    one, other = (_signals(t_s, xyt, grid, smoothing_s, by_course=by_course) for t_s, xyt in pair)
    count = min(round(reach_s / step), len(grid) - 1)
    turn, speed = (_correlation(one[:, i], other[:, i], count) for i in (0, 1))
    varies = bool((_vary(one) & _vary(other)).any())
    return CrossCorrelation(np.arange(-count, count + 1) * step, speed, turn, varies=varies)


def _vary(signals: Array) -> NDArray[np.bool_]:
    """Return whether yaw rate and speed (2,) of signals (m, 2) vary more than noise may."""
    seen = np.isfinite(signals).all(axis=1)
    there = signals[seen] if seen.any() else np.zeros((1, 2))
    return there.std(axis=0) > (_TURNS_RADPS, max(_SPEEDS_MPS, _SPEEDS * np.sqrt(np.mean(there[:, 1] ** 2))))


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
    there_a, there_b = np.isfinite(a).astype(np.float64), np.isfinite(b).astype(np.float64)
    a, b = np.where(there_a > 0, a, 0.0), np.where(there_b > 0, b, 0.0)

    def shifted(x: Array, y: Array) -> Array:
        return correlate(x, y, method="fft")[len(x) - 1 - count : len(x) + count]

    n = np.maximum(shifted(there_a, there_b), 1.0)
    mean_a, mean_b = shifted(a, there_b) / n, shifted(there_a, b) / n
    cross = shifted(a, b) / n - mean_a * mean_b
    var_a = shifted(a * a, there_b) / n - mean_a**2
    var_b = shifted(there_a, b * b) / n - mean_b**2
    scale = np.sqrt(np.maximum(var_a, 1e-9) * np.maximum(var_b, 1e-9))
    # With little overlap, correlations are high by chance.
    return np.where(n > 0.3 * n.max(), cross / scale, 0.0)


SHORTEST_S = 10.0
"""Minimum overlap of odometry and truth, seconds."""
_STILL_M, _STILL_RAD = 0.05, 0.1
_MOVES_M, _FACTOR = 0.5, 300.0
"""Extent that is motion, and factor from which less is none, not another unit."""
_CLEAR = 0.7  # correlation at which a time shift is suggested
_DAY_S = 86_400.0
_YEAR_S = 365.25 * _DAY_S


def check_pair(odometry: Samples, truth: Samples) -> None:
    """Refuse odometry and truth that cannot be one run: disjoint times, or no motion."""
    _check_time(odometry, truth)
    both = [odometry.only(odometry.within(truth)), truth.only(truth.within(odometry))]
    for part, whole in zip(both, (odometry, truth), strict=True):
        if len(part) < FEWEST:
            raise RecordingError(
                f"{whole.place}: only {len(part)} of its {len(whole)} poses are in the common time of odometry and "
                f"truth; {FEWEST} and more are needed: record longer"
            )
    _check_motion(*both)


def _check_time(odometry: Samples, truth: Samples) -> None:
    shared = odometry.shared_s(truth)
    if shared >= SHORTEST_S:
        return
    for path in (odometry, truth):
        if path.span_s < SHORTEST_S:
            raise RecordingError(
                f"{path.place}: lasts {path.span_s:.1f} s; a study takes {SHORTEST_S:g} s, better minutes"
            )
    apart_s = abs(float(truth.stamps_ns[0] - odometry.stamps_ns[0]) * 1e-9)
    units = ((_YEAR_S, "years"), (_DAY_S, "days"), (1.0, "s"))
    per_s, unit = next((one for one in units if apart_s > one[0]), units[-1])
    found = f"share {shared:.1f} s" if shared > 0.0 else "have no time in common"
    reach_s = max(odometry.span_s, truth.span_s)
    corr = cross_correlation(odometry.trajectory(), truth.trajectory(), reach_s, from_start=True)
    best = int(np.argmax(corr.both))
    start_s = float(odometry.stamps_ns[0] - truth.stamps_ns[0]) * 1e-9
    way_out = f"if both began together, give --truth-shift {start_s:.1f}"
    if corr.both[best] > _CLEAR:
        way_out = f"the motions match with --truth-shift {start_s + corr.lag_s[best]:.1f}"
    clock = " (one clock is simulated, unset, or counts from its start)" if apart_s > _DAY_S else ""
    raise RecordingError(
        f"{odometry.place} and {truth.place} {found}: odometry is from {_span(odometry)}, truth from {_span(truth)}, "
        f"their starts {apart_s / per_s:.1f} {unit} apart{clock}; {way_out}"
    )


def _check_motion(here: Samples, there: Samples) -> None:
    extents = [float(np.linalg.norm(np.std(p.xyz[:, :2], axis=0))) for p in (here, there)]
    turns = [float(np.ptp(np.unwrap(p.yaw_rad))) if p.headed else 0.0 for p in (here, there)]
    if extents[0] < _STILL_M and turns[0] < _STILL_RAD:
        if extents[1] > _MOVES_M and extents[0] * _FACTOR > extents[1]:
            return
        said = f"no motion: {extents[0] * 1000:.0f} mm and {np.degrees(turns[0]):.1f} deg in {here.span_s:.0f} s; "
        said += "record a drive with turns both ways"
        if extents[1] > _MOVES_M:
            said = f"stands still while the truth moves over {extents[1]:.1f} m; name the odometry of this robot; "
            said += "`odomcorrupt integrate` makes poses of twists"
        raise RecordingError(f"{here.place}: {said}")
    if extents[0] > _MOVES_M and extents[1] < _STILL_M and extents[1] * _FACTOR < extents[0]:
        degrees = 0.3 < extents[1] * 111e3 / extents[0] < 3.0  # metres of a degree of latitude
        way_out = "give metres, not degrees of latitude and longitude" if degrees else "name the truth of this robot"
        raise RecordingError(f"{there.place}: stands still while the odometry moves over {extents[0]:.1f} m; {way_out}")


def _span(path: Samples) -> str:
    ends = path.stamps_ns[[0, -1]]
    if ends[0] < _YEAR_S * 1e9:
        return f"{ends[0] * 1e-9:.1f} s to {ends[1] * 1e-9:.1f} s"
    first, last = (str(end).replace("T", " ") for end in ends.astype("datetime64[ns]").astype("datetime64[s]"))
    return f"{first} to {last} UTC"


_WINDOW_S = 2.0
"""Averaging time of the compared motions, which removes the truth's noise and the wheels' jitter."""
_MAX_LAG_S = 60.0  # largest lag
_MIN_NEAR, _MIN_ANY = 0.45, 0.5
"""Least correlation of speed or yaw rate in one drive: at small lags, and at any lag."""
_TURNS_RADPS, _SPEEDS_MPS, _SPEEDS = 0.05, 0.03, 0.15
"""Standard deviations of yaw rate, speed, and speed relative to its root mean square, below which it may be noise."""


def check_together(here: Samples, there: Samples) -> None:
    """Refuse a truth whose motion does not correlate with the odometry's at any lag."""
    reach_s = min(_MAX_LAG_S, here.span_s / 2.0)
    corr = cross_correlation(here.trajectory(), there.trajectory(), reach_s, smoothing_s=_WINDOW_S)
    best = np.maximum(corr.turn, corr.speed)
    # drives of one pattern correlate at some lag, but nearly as well at others; noise of positions does so, too
    elsewhere = best[np.abs(corr.lag_s - corr.lag_s[np.argmax(best)]) > CLOCK_S].max(initial=0.0)
    unlike = best[np.abs(corr.lag_s) <= CLOCK_S].max() < _MIN_NEAR and best.max() < _MIN_ANY
    if corr.varies and (unlike or (there.headed and best.max() < min(_CLEAR, 1.25 * elsewhere))):
        raise RecordingError(
            f"{there.place}: does not move as {here.name} does (speeds correlate by {corr.speed.max():.2f}, yaw rates "
            f"by {corr.turn.max():.2f}, at the best shift of up to {reach_s:.0f} s): it is of another drive or of "
            "another robot, less accurate than the motion (GPS without corrections), a correction (map -> odom), its "
            "clock is farther off, or one of them is computed wrongly (steering angles in degrees); name the truth of "
            "this run"
        )

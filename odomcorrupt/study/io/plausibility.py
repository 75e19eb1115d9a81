"""Plausibility checks of odometry and truth as one run, before any computation.

Of two paths of different drives, only clear mismatches are refused. Wheels slip, fixes drift and platforms move
sideways, yet over two seconds speed or yaw rate still agrees with the odometry. The better of the two correlations is
at least 0.6 in 19 recordings by others, and at most 0.4 between different drives of some minutes.

Checks, in order of the file: units of lengths and of headings; turning direction, plane of motion and clock, by the
cross-correlation of two motions over lags, which is independent of their frames; and whether the two are of one run.
All compare motions over intervals, so that neither frames nor tracked points matter. A single path is checked for
headings that agree with its direction of travel.

The travel of a truth may be copied from the odometry, by filters that take speed from the wheels and heading from a
gyro. Slip, ticks and noise of the wheels are then in both, so that no error of travel can be seen. No sensor agrees
with wheels to 0.1 mm in half a second: in 15 recordings by others the usual difference is 0.2 mm and more. Exact poses
of a simulator may agree as well, but they are smooth where the odometry has ticks.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.corruption.pose_faults import PER_METRE
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.motion import slopes
from odomcorrupt.geometry.se2 import increments, wrap
from odomcorrupt.geometry.trajectory import distance_along

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


_MIN_WIDTH_M = 0.05  # smaller widths of a path in x-y are not compared
_MIRRORED = 0.5  # magnitude of a negative yaw rate correlation that suggests a mirrored axis
_SAME_SHAPE = 0.15  # relative residual of a path's alignment below which two paths have the same shape


def check_plane(here: Samples, there: Samples) -> None:
    """Refuse a truth that moves in the x-z or y-z plane: its width in x-y is then far below the odometry's."""
    wide = _width(here.xyz[:, :2])
    if _width(there.xyz[:, :2]) > 0.25 * wide or wide < _MIN_WIDTH_M:
        return
    for up, plane in (("y", [0, 2]), ("x", [1, 2])):
        if _width(there.xyz[:, plane]) > 0.5 * wide:
            axes = "xyz"[plane[0]] + "-" + "xyz"[plane[1]]
            raise RecordingError(
                f"{there.place}: moves in its {axes} plane, not in x-y: {up} points up there; turn it so that z does"
            )


def check_turning(here: Samples, there: Samples) -> None:
    """Refuse a truth whose yaw rate has the opposite sign of the odometry's, or whose clock is shifted."""
    corr = cross_correlation(here.trajectory(), there.trajectory(), min(_MAX_LAG_S, here.span_s / 2.0))
    near = np.abs(corr.lag_s) <= _SAME_CLOCK_S
    best, flipped = int(np.argmax(corr.both)), int(np.argmin(np.where(near, corr.turn, 1.0)))
    least, most = float(corr.turn[flipped]), float(corr.turn[near].max())
    # A periodic drive looks mirrored half a period later: refuse only if no clock offset explains it better.
    if least < -_MIRRORED and most < 0.5 * abs(least) and corr.both[best] < corr.mirrored[flipped] + 0.02:
        raise RecordingError(
            f"{there.place}: turns right where the odometry turns left (yaw rates correlate by {least:.2f}): one of "
            "its axes is mirrored, or it has compass headings; flip it"
        )
    if corr.both[best] > _CLEAR and corr.both[near].max() < 0.5 * corr.both[best]:
        side = "behind" if corr.lag_s[best] > 0.0 else "ahead of"
        raise RecordingError(
            f"{there.place}: its clock is {abs(corr.lag_s[best]):.1f} s {side} the odometry's (motions correlate by "
            f"{corr.both[best]:.2f} there, by {corr.both[near].max():.2f} as they are); give --truth-shift "
            f"{corr.lag_s[best]:.1f}"
        )


def check_shape(here: Samples, there: Samples) -> None:
    """Refuse a truth that matches the odometry's path only when mirrored (also finds it in drives without turns)."""
    p, q = _shape(here, here), _shape(there, here)
    whole = float(np.sum(np.abs(p) ** 2) + np.sum(np.abs(q) ** 2))
    both = np.array([np.abs(np.vdot(p, q)), np.abs(np.sum(p * q))])
    turned, flipped = np.sqrt(np.maximum(1.0 - 2.0 * both / whole, 0.0)).tolist()
    if flipped < _SAME_SHAPE and turned > 3.0 * flipped and turned > _SAME_SHAPE:
        raise RecordingError(
            f"{there.place}: its path is the odometry's in a mirror ({flipped:.0%} off, {turned:.0%} without one): one "
            "of its axes is mirrored; flip it"
        )


def _shape(path: Samples, clock: Samples) -> NDArray[np.complex128]:
    """Return a path's positions as complex numbers about their mean, interpolated at the stamps of `clock`."""
    own, at = (x.seconds_since(int(clock.stamps_ns[0])) for x in (path, clock))
    xy = [np.interp(at, own, path.xyz[:, i]) for i in (0, 1)]
    return (xy[0] - np.mean(xy[0])) + 1j * (xy[1] - np.mean(xy[1]))


def _width(plane: Array) -> float:
    """Return the smaller of the two standard deviations of points (n, 2) about their axes."""
    return float(np.linalg.svd(plane - plane.mean(axis=0), compute_uv=False)[-1] / np.sqrt(len(plane)))


_GIVE_METRES = (
    "Give metres: mend the publisher and record again, or write the poses to a CSV file, whose columns x_mm, y_mm (or "
    "x_ft, y_ft, ...) name the unit"
)
"""What to do about lengths in another unit."""

_OF_A_UNIT = 1.1  # factor from a unit within which a ratio of travels is that unit
_MAX_RATIO = 20.0  # ratio of travels that no robot has
_USUAL = 1.3  # ratio of travels up to which wheels may be wrong
_WINDOWS_S = (2.0, 5.0, 10.0)
_USUALLY = 90.0  # percentile of distances: robots that stand most of the time move in this one
_LEAST_M = 0.1

_PER_DEGREE = 180.0 / np.pi
_DEGREES = (
    "its headings are degrees, not radians; in a CSV file, name the column yaw_deg; for a bag, convert them before "
    "making quaternions, and record again"
)
_SO_FAR = "they turn 57 times as far as"
_TURN_RAD, _LARGE_RAD = 0.03, 0.12  # least and largest turns compared: 57 times the least is about a quarter turn
_MIN_TURNS = 30
_STEP_S, _LEAST_STEP_M = 0.04, 0.002  # steps whose directions are compared with headings
_FITS, _MISFITS = 0.5, 0.5  # mean cosines of the differences of turns


def check_lengths(odometry: Samples, truth: Samples) -> list[str]:
    """Refuse lengths in different units; return a warning if the travels differ more than those of wrong wheels.

    Raises
    ------
    RecordingError
        If the ratio of travels is that of a unit to the metre, or beyond 20.
    """
    ratio = _ratio_of_travel(odometry, truth)
    if not ratio:
        return []
    small, large = (odometry, truth) if ratio > 1.0 else (truth, odometry)
    factor = max(ratio, 1.0 / ratio)
    unit = next((name for name, per_m in PER_METRE.items() if 1.0 / _OF_A_UNIT < factor / per_m < _OF_A_UNIT), None)
    if unit is not None or factor > _MAX_RATIO:
        raise RecordingError(
            f"{large.place}: covers {factor:.3g} times as much ground as {small.place}: {unit or 'another unit'} for "
            f"metres? {_GIVE_METRES}"
        )
    if factor < _USUAL:
        return []
    said = (
        f"{large.name} travels {factor:.3g} times as far as {small.name}: check units, gear ratio and wheel radius of "
        "both before using this result"
    )
    return [said]


def _ratio_of_travel(odometry: Samples, truth: Samples) -> float:
    """Return the truth's usual distance within some seconds over the odometry's; 0 if the robot hardly moves.

    Noise lengthens short distances, and errors of heading shorten long ones: the most ordinary ratio counts. Lags do
    not matter.
    """
    origin = int(odometry.stamps_ns[0])
    first_s, last_s = (float(p.seconds_since(origin)[i]) for p, i in ((truth, 0), (truth, -1)))
    ratios = []
    for window_s in _WINDOWS_S:
        starts = np.arange(max(first_s, 0.0), min(last_s, odometry.span_s) - window_s, window_s / 4.0)
        if len(starts) < 4:
            continue
        here, there = (_usual_distance(p, p.seconds_since(origin), starts, window_s) for p in (odometry, truth))
        if max(here, there) > _LEAST_M and min(here, there) > 0.0:
            ratios.append(there / here)
    return min(ratios, key=lambda ratio: abs(np.log(ratio)), default=0.0)


def _usual_distance(path: Samples, t_s: Array, starts: Array, window_s: float) -> float:
    ends = [np.interp(at, t_s, path.xyz[:, i]) for at in (starts, starts + window_s) for i in (0, 1)]
    return float(np.percentile(np.hypot(ends[2] - ends[0], ends[3] - ends[1]), _USUALLY))


def check_degrees(odometry: Samples, truth: Samples) -> None:
    """Refuse headings that turn 57 times as far as those of the other path, or as the odometry's path does.

    A quaternion made of degrees hides them, because its headings are wrapped: differences are compared on the circle.

    Raises
    ------
    RecordingError
        If the headings of one path are in degrees.
    """
    _check_own_degrees(odometry)
    if not truth.headed:
        return
    at = truth.seconds_since(int(odometry.stamps_ns[0]))
    inside = (at >= 0.0) & (at <= odometry.span_s)
    heading = np.interp(at[inside], odometry.t_s, np.unwrap(odometry.yaw_rad))
    picked = _turning_points(heading)
    if _in_degrees(np.diff(truth.yaw_rad[inside][picked]), np.diff(heading[picked])):
        raise RecordingError(f"{truth.place}: {_DEGREES} ({_SO_FAR} those of {odometry.name})")


def _check_own_degrees(odometry: Samples) -> None:
    stride = max(1, round(_STEP_S / float(np.median(np.diff(odometry.t_s)))))
    path = odometry.only(np.arange(0, len(odometry), stride))
    steps = np.diff(path.xyz[:, :2], axis=0)
    course = np.arctan2(steps[:, 1], steps[:, 0])
    # The turn during a step is half of that between the steps around it.
    around = wrap(course[2:] - course[:-2]) / 2.0
    moves = np.linalg.norm(steps, axis=1) > _LEAST_STEP_M
    sure = moves[2:] & moves[1:-1] & moves[:-2] & (np.abs(around) > _TURN_RAD / 2.0)
    if _in_degrees(np.diff(path.yaw_rad)[1:-1][sure], around[sure]):
        raise RecordingError(f"{odometry.place}: {_DEGREES} ({_SO_FAR} its path does)")


def _turning_points(heading: Array) -> list[int]:
    """Return the indices of headings (n,) that differ by about 0.03 rad from one to the next."""
    picked = [0] if len(heading) else []
    for i, value in enumerate(heading.tolist()):
        if abs(value - heading[picked[-1]]) >= _TURN_RAD:
            picked.append(i)
    return picked


def _in_degrees(turned: Array, other: Array) -> bool:
    small = np.abs(other) < _LARGE_RAD  # beside outages turns are larger, and their errors too
    turned, other = turned[small], other[small]
    if len(turned) < _MIN_TURNS:
        return False
    fits, misfits = (float(np.mean(np.cos(turned - k * other))) for k in (_PER_DEGREE, 1.0))
    return fits > _FITS and misfits < _MISFITS


SHORTEST_S = 10.0
"""Minimum overlap of odometry and truth, seconds."""
_MIN_POSES = 20
_STILL_M, _STILL_RAD = 0.05, 0.1
_MOVES_M = 1.0
_CLEAR = 0.7  # correlation at which a time shift is suggested
_DAY_S = 86_400.0
_YEAR_S = 365.25 * _DAY_S


def check_pair(odometry: Samples, truth: Samples) -> list[str]:
    """Refuse odometry and truth that cannot be one run: disjoint times, no motion, other units, axes or clocks.

    Returns alerts about travels that differ more than is usual.

    Raises
    ------
    RecordingError
        With the value found and the remedy.
    """
    _check_time(odometry, truth)
    first, last = max(odometry.stamps_ns[0], truth.stamps_ns[0]), min(odometry.stamps_ns[-1], truth.stamps_ns[-1])
    here = odometry.only(_within(odometry, first, last))
    there = truth.only(_within(truth, first, last))
    for part, whole in ((here, odometry), (there, truth)):
        if len(part) < _MIN_POSES:
            raise RecordingError(
                f"{whole.place}: only {len(part)} of its {len(whole)} poses are in the common time of odometry and "
                f"truth; {_MIN_POSES} and more are needed: record longer"
            )
    _check_motion(here, there)
    alerts = check_lengths(here, there)
    check_plane(here, there)
    check_turning(here, there)
    check_shape(here, there)
    check_together(here, there)
    return alerts


def _check_time(odometry: Samples, truth: Samples) -> None:
    shared = (
        float(min(odometry.stamps_ns[-1], truth.stamps_ns[-1]) - max(odometry.stamps_ns[0], truth.stamps_ns[0])) * 1e-9
    )
    if shared >= SHORTEST_S:
        return
    for path in (odometry, truth):
        if path.span_s < SHORTEST_S:
            raise RecordingError(
                f"{path.place}: lasts {path.span_s:.1f} s; a study takes {SHORTEST_S:g} s, better minutes"
            )
    apart = float(truth.stamps_ns[0] - odometry.stamps_ns[0]) * 1e-9
    far = abs(apart)
    size = (
        f"{far / _YEAR_S:.1f} years"
        if far > _YEAR_S
        else f"{far / _DAY_S:.1f} days"
        if far > _DAY_S
        else f"{far:.1f} s"
    )
    found = f"share {shared:.1f} s" if shared > 0.0 else "have no time in common"
    clock = " (one clock is simulated, unset, or counts from its start)" if far > _DAY_S else ""
    raise RecordingError(
        f"{odometry.place} and {truth.place} {found}: odometry is from {_span(odometry)}, truth from {_span(truth)}, "
        f"their starts {size} apart{clock}; {_shift(odometry, truth)}"
    )


def _shift(odometry: Samples, truth: Samples) -> str:
    """Return the advice on --truth-shift: the shift that matches the motions, or the one that matches the starts."""
    reach = max(odometry.span_s, truth.span_s)
    corr = cross_correlation(odometry.trajectory(), truth.trajectory(), reach, from_start=True)
    best = int(np.argmax(corr.both))
    start_s = float(odometry.stamps_ns[0] - truth.stamps_ns[0]) * 1e-9
    if corr.both[best] > _CLEAR:
        return f"the motions match with --truth-shift {start_s + corr.lag_s[best]:.1f}"
    return f"if both began together, give --truth-shift {start_s:.1f}"


def _check_motion(here: Samples, there: Samples) -> None:
    extents = [float(np.linalg.norm(np.std(p.xyz[:, :2], axis=0))) for p in (here, there)]
    turns = [float(np.ptp(np.unwrap(p.yaw_rad))) if p.headed else 0.0 for p in (here, there)]
    if extents[0] < _STILL_M and turns[0] < _STILL_RAD:
        if extents[1] > _MOVES_M:
            raise RecordingError(
                f"{here.place}: stands still while the truth moves over {extents[1]:.1f} m; name the odometry of this "
                "robot; `odomcorrupt integrate` makes poses of twists"
            )
        raise RecordingError(
            f"{here.place}: no motion: {extents[0] * 1000:.0f} mm and {np.degrees(turns[0]):.1f} deg in "
            f"{here.span_s:.0f} s; record a drive with turns both ways"
        )
    if extents[0] > _MOVES_M and extents[1] < _STILL_M:
        raise RecordingError(
            f"{there.place}: stands still while the odometry moves over {extents[0]:.1f} m; name the truth of this "
            "robot"
        )


def _within(path: Samples, first: np.int64, last: np.int64) -> NDArray[np.bool_]:
    return (path.stamps_ns >= first) & (path.stamps_ns <= last)


def _span(path: Samples) -> str:
    first, last = (float(path.stamps_ns[i]) * 1e-9 for i in (0, -1))
    if first < _YEAR_S:
        return f"{first:.1f} s to {last:.1f} s"
    try:
        begin, end = (datetime.fromtimestamp(t, UTC).strftime("%Y-%m-%d %H:%M:%S") for t in (first, last))
    except (OverflowError, ValueError, OSError):
        return f"{first:.0f} s to {last:.0f} s"
    return f"{begin} to {end} UTC"


_WINDOW_S = 2.0
"""Averaging time of the compared motions, which removes the truth's noise and the wheels' jitter."""
_MAX_LAG_S = 60.0  # largest lag
_SAME_CLOCK_S = 3.0  # lags up to here count as the same clock
_MIN_NEAR, _MIN_ANY = 0.45, 0.5
"""Least correlation of speed or yaw rate in one drive: at small lags, and at any lag."""
_TURNS_RADPS, _SPEEDS_MPS, _SPEEDS = 0.05, 0.03, 0.15
"""Standard deviations of yaw rate, speed, and speed relative to its root mean square, below which it may be noise."""


def check_together(here: Samples, there: Samples) -> None:
    """Refuse a truth whose motion does not correlate with the odometry's at any lag.

    Raises
    ------
    RecordingError
        With the correlations found and the remedy.
    """
    reach_s = min(_MAX_LAG_S, here.span_s / 2.0)
    corr = cross_correlation(here.trajectory(), there.trajectory(), reach_s, smoothing_s=_WINDOW_S)
    both = (corr.odometry, corr.truth)
    turning = all(s.turn_radps > _TURNS_RADPS for s in both)
    accelerating = all(s.speed_mps > max(_SPEEDS_MPS, _SPEEDS * s.level_mps) for s in both)
    near = np.abs(corr.lag_s) <= _SAME_CLOCK_S
    best = np.maximum(corr.turn, corr.speed)
    if (turning or accelerating) and best[near].max() < _MIN_NEAR and best.max() < _MIN_ANY:
        raise RecordingError(
            f"{there.place}: does not move as {here.name} does (speeds correlate by {corr.speed.max():.2f}, yaw rates "
            f"by {corr.turn.max():.2f}, at the best shift of up to {reach_s:.0f} s): it is of another drive or of "
            "another robot, or its clock is farther off; name the truth of this run"
        )


_DEGREE = np.pi / 180.0
_SELF_CLEAR, _UNCLEAR = 0.9, 0.6  # agreement of a better reading of the headings, and of the given one, for a refusal
_MIN_CHORDS = 12
_CHORDS = 40  # chords per extent of the path
_SPEED_S = 2.0
_MAX_MPS = 60.0  # m/s

_READINGS = (
    (-1.0, "its headings turn the other way than its path does: an axis is mirrored, or they are compass headings; {}"),
    (_DEGREE, "its headings are degrees, not radians; {}"),
    (-_DEGREE, "its headings are degrees of a compass (clockwise), not radians counter-clockwise; {}"),
    (1.0 / _DEGREE, "its headings were read as degrees, but are radians; {}"),
)


def check_itself(path: Samples) -> None:
    """Refuse a path with implausible headings or units.

    Chords of the path point along the heading or straight backwards, up to a constant mounting angle. Twice the chord's
    angle minus twice the heading is therefore constant. If this holds for degrees or mirrored headings and not for the
    given headings, those are wrong.

    Raises
    ------
    RecordingError
        If headings are in degrees or mirrored, or the usual speed exceeds 60 m/s.
    """
    t_s = path.t_s
    later = np.searchsorted(t_s, t_s + _SPEED_S)
    here = np.flatnonzero(later < len(t_s))
    later = later[here]
    speed = np.linalg.norm(path.xyz[later, :2] - path.xyz[here, :2], axis=1) / (t_s[later] - t_s[here])
    usual = float(np.median(speed[speed > 0.0])) if np.any(speed > 0.0) else 0.0
    if usual > _MAX_MPS:
        raise RecordingError(
            f"{path.place}: it usually moves at {usual:.0f} m/s: millimetres for metres? {_GIVE_METRES}"
        )
    if not path.headed:
        return
    course, yaw = _chords(path)
    if len(course) < _MIN_CHORDS:
        return
    if _agreement(course, yaw) > _UNCLEAR:
        return
    for factor, sentence in _READINGS:
        if _agreement(course, factor * yaw) > _SELF_CLEAR:
            way_out = "in a CSV file, name the column yaw_deg or yaw_rad, as it is; turn a compass by 90 deg - yaw"
            raise RecordingError(f"{path.place}: {sentence.format(way_out)}")


def _chords(path: Samples) -> tuple[Array, Array]:
    """Return the angles of chords (k,), and the headings (k,) at their middle, radians."""
    xy = path.xyz[:, :2]
    extent = float(np.linalg.norm(np.std(xy, axis=0)))
    noise = float(np.median(np.abs(np.diff(xy, n=2, axis=0)))) if len(xy) > 2 else 0.0
    length = max(extent / _CHORDS, 15.0 * noise, 1e-6)
    picked = [0]
    # The travelled distance only bounds the chord from above: continue until the chord itself is long enough.
    gone = distance_along(xy)
    at = 0
    while (at := int(np.searchsorted(gone, gone[at] + length))) < len(xy):
        if np.linalg.norm(xy[at] - xy[picked[-1]]) > length / 2.0:
            picked.append(at)
    ends = np.array(picked)
    chord = np.diff(xy[ends], axis=0)
    return np.arctan2(chord[:, 1], chord[:, 0]), path.yaw_rad[(ends[:-1] + ends[1:]) // 2]


def _agreement(course: Array, yaw: Array) -> float:
    """Return the concentration of twice the difference of two angles: 1 for a constant, about 0 for no relation."""
    return float(np.abs(np.mean(np.exp(2j * (course - yaw)))))


_COPIED_WINDOW_S = 0.5
_COPIED_MAX_LAG_S = 1.0
_LAG_STEPS_S = (0.02, 0.002, 0.0002)
_MOVING, _TOP = 0.2, 95.0  # part of the usual top speed from which a window counts; percentile of that speed
_MIN_WINDOWS = 20
_NO_SENSOR_M, _NO_SENSOR = 1e-4, 5e-4
"""Usual difference of travel in half a second, m and relative to the travel, that no sensor reaches."""
_ROUGH_M = 1e-6  # noise of odometry's steps, m: less is the rounding of a smooth simulation
_AS_ROUGH = 0.3  # noise of the truth's travel relative to the odometry's


class _Travel(NamedTuple):
    t_s: Array
    gone_m: Array

    def in_windows(self, starts_s: Array) -> Array:
        """Return the signed travel (k,) in half a second from each start."""
        begin, end = (np.interp(at, self.t_s, self.gone_m) for at in (starts_s, starts_s + _COPIED_WINDOW_S))
        return np.asarray(end - begin)

    @property
    def noise_m(self) -> float:
        """Usual noise of a step while the robot moves, from third differences of the travel, m."""
        rough = np.abs(np.diff(self.gone_m, n=3))[_moving(np.diff(self.gone_m))[2:]]
        return float(np.median(rough)) / np.sqrt(20.0) if len(rough) else 0.0


def check_travel(odometry: Samples, truth: Samples) -> None:
    """Refuse a truth whose travel is the odometry's with its noise, at whatever lag and rate.

    Raises
    ------
    RecordingError
        With the difference found and the remedy.
    """
    if not truth.headed or truth.covariance is not None or truth.relative:
        return
    own, real = (_travel(path, int(odometry.stamps_ns[0])) for path in (odometry, truth))
    noise_m = own.noise_m
    if noise_m < _ROUGH_M or real.noise_m < _AS_ROUGH * noise_m:
        return
    starts = np.arange(max(own.t_s[0], real.t_s[0]), min(own.t_s[-1], real.t_s[-1]), _COPIED_WINDOW_S)
    starts = starts[
        (starts >= own.t_s[0] + _COPIED_MAX_LAG_S) & (starts < own.t_s[-1] - _COPIED_MAX_LAG_S - _COPIED_WINDOW_S)
    ]
    own_m = own.in_windows(starts)
    used = _moving(own_m)
    if used.sum() < _MIN_WINDOWS:
        return
    starts, own_m = starts[used], own_m[used]

    def off_m(lag_s: float) -> float:
        return float(np.median(np.abs(real.in_windows(starts + lag_s) - own_m)))

    lag_s, reach_s = 0.0, _COPIED_MAX_LAG_S
    for step_s in _LAG_STEPS_S:
        lag_s = min(np.arange(lag_s - reach_s, lag_s + reach_s, step_s).tolist(), key=off_m)
        reach_s = step_s
    found_m, gone_m = off_m(lag_s), float(np.median(np.abs(own_m)))
    if found_m < min(_NO_SENSOR_M, _NO_SENSOR * gone_m):
        raise RecordingError(
            f"{truth.place}: repeats the travel of {odometry.name} with its noise and slip (usually to "
            f"{found_m * 1e3:.2g} mm in {gone_m * 1e3:.0f}): a filter that takes its speed from these wheels, so that "
            "errors of travel cannot be seen; name a truth that does not come from them"
        )


def _travel(path: Samples, origin_ns: int) -> _Travel:
    steps = increments(path.trajectory().xyt)
    return _Travel(path.seconds_since(origin_ns), np.concatenate(([0.0], np.cumsum(steps.ds_m))))


def _moving(steps_m: Array) -> NDArray[np.bool_]:
    size = np.abs(steps_m)
    return size > _MOVING * np.percentile(size, _TOP) if len(size) else size > 0.0

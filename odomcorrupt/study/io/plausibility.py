"""Plausibility checks of odometry and truth as one run, before any computation.

Of two paths of different drives, only clear mismatches are refused. Wheels slip, fixes drift and platforms move
sideways, yet over two seconds speed or yaw rate still agrees with the odometry. The better of the two correlations is
at least 0.6 in 19 recordings by others, and at most 0.4 between different drives of some minutes.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.study.io.axes import check_plane, check_shape, check_turning
from odomcorrupt.study.io.cross_correlation import cross_correlation
from odomcorrupt.study.io.units import check_lengths

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.study.io.raw_trajectory import Samples

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

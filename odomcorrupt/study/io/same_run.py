"""Check that odometry and truth belong to the same drive.

Only clear mismatches are refused. Wheels slip, fixes drift and platforms move sideways, yet over two seconds speed or
yaw rate still agrees with the odometry. The better of the two correlations is at least 0.6 in 19 recordings by others,
and at most 0.4 between different drives of some minutes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.study.io.cross_correlation import cross_correlation

if TYPE_CHECKING:
    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["check_together"]

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

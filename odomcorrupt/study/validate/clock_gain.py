"""Reduction of the drift by clock correction."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from odomcorrupt.study.estimate.intervals import join
from odomcorrupt.study.estimate.windows import distance_windows, rmse, time_windows
from odomcorrupt.study.io.clock import Clock, aligned

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.io.recording import Recording

__all__ = ["ClockGain", "clock_gain"]


@dataclass(frozen=True, slots=True)
class ClockGain:
    """Position errors, metres, without and with clock correction; NaN if a drive is too short."""

    after_10m: tuple[float, float]
    after_50m: tuple[float, float]
    after_10s: tuple[float, float]


def clock_gain(recordings: Sequence[Recording], clocks: Sequence[Clock]) -> ClockGain:
    """Return the drift without and with clock correction, over non-overlapping windows that start at the truth."""
    before = [aligned(r, Clock()) for r in recordings]
    after = [aligned(r, c) for r, c in zip(recordings, clocks, strict=True)]

    def both(windows: tuple[list[Intervals], list[Intervals]]) -> tuple[float, float]:
        first, second = (rmse(join(w, [0] * len(w))) if w else float("nan") for w in windows)
        return first, second

    def over(length_m: float) -> tuple[float, float]:
        first, second = ([w for r in side if len(w := distance_windows(r, length_m))] for side in (before, after))
        return both((first, second))

    timed = ([w for r in side if len(w := time_windows(r))] for side in (before, after))
    first, second = timed
    return ClockGain(over(10.0), over(50.0), both((first, second)))

"""Clock offset and rate of the odometry relative to the truth: stamp = t + offset + rate t, t from the origin.

Clocks are estimated first: an unmodelled offset of 30 ms looks like slip or backlash and inflates every coefficient.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import theilslopes

from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.io.headings import with_headings
from odomcorrupt.study.io.plausibility import cross_correlation
from odomcorrupt.study.io.raw_trajectory import CLOCK_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Recording

_STRETCH_S = 40.0  # shortest part of a run that is matched on its own


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


def as_rows(clocks: Sequence[Clock]) -> Array:
    """Return offsets and rates (R, 2) of clocks."""
    return np.array([(clock.offset_s, clock.rate) for clock in clocks]).reshape(-1, 2)


def led(free: NDArray[np.bool_], leaders: Sequence[int]) -> NDArray[np.bool_]:
    """Return the mask (R, 2) of free clock parameters with a shared clock left free in its first recording only."""
    return free & (np.array(leaders) == np.arange(len(leaders)))[:, None]


def coarse_clock(recording: Recording) -> Clock:
    """Return initial clock values, accurate to about 0.05 s, from matched speeds and yaw rates.

    Parts of the run are matched separately at lags within +- 3 s; a Theil-Sen line fits their lags.
    """
    truth, odo_s, truth_s = recording.truth, recording.odometry_s, recording.truth_s
    first_s, last_s = max(odo_s[0], truth_s[0]) + CLOCK_S, min(odo_s[-1], truth_s[-1]) - CLOCK_S
    if last_s - first_s < 4.0 * CLOCK_S:
        return Clock()
    times, lags = [], []
    edges = np.linspace(first_s, last_s, int(np.clip((last_s - first_s) // _STRETCH_S, 1, 12)) + 1)
    for begin_s, end_s in pairwise(edges.tolist()):
        part = truth.only((truth_s >= begin_s) & (truth_s <= end_s))
        if len(part) < 2:
            continue
        found = cross_correlation(recording.odometry, part, CLOCK_S)
        best = int(np.argmax(found.both))
        if found.both[best] > 0.5 and 0 < best < len(found.both) - 1:
            before, here, after = found.both[best - 1 : best + 2].tolist()
            within = 0.5 * (after - before) / (2.0 * here - before - after)  # vertex of a parabola
            times.append((begin_s + end_s) / 2.0)
            lag_s = float(np.interp(best + within, np.arange(len(found.lag_s)), found.lag_s))
            lags.append(round(20.0 * lag_s) / 20.0)  # to 0.05 s: a smaller offset would cost the ends of a short drive
    if not times:
        return Clock()
    if len(times) < 4:
        return Clock(float(np.median(lags)))
    line = theilslopes(lags, times)
    return Clock(float(line.intercept), float(line.slope))

"""Dead band of a gyro: yaw rates below a threshold are reported as exactly zero, although the robot turns."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import increments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

_ZERO_RAD, _ZERO_M = 1e-9, 1e-6
"""Largest turn and travel in an interval that count as zero: rounding of quaternions and of sums."""
_CLEAR = 1e3
"""Least turn of a band, as a multiple of the largest that counts as zero: smaller ones are what rounding leaves."""
_FEWEST = 30
"""Fewest intervals with a turn between once and twice the threshold. Of a smooth density, as many would lie below."""
_EDGE, _SPREAD = 0.05, 0.5
"""Turns within this fraction of the band's end or of its double may be multiples of a step (ticks, truncated rates);
least share of the others: 0.9 if turns are evenly distributed."""
_RUN_S, _RUNS = 1.0, 5
"""Shortest time, s, at zero in motion over which the truth's turn is compared with its noise, and fewest such times."""
_TURNS, _ERRORS = 0.1, 3.0
"""Least root mean square rate of the truth in these times, as a fraction of the threshold, and least ratio of its mean
square turn to that of the truth's noise."""
_SOME, _MISSING, _SURE = 0.3, 0.2, 5.0
"""Least share of zeros in such a time with slow turns; least ratio of the turn that the odometry then misses to the
turn that it reports, larger than any scale error, and its least value in standard errors."""


def yaw_dead_band(odometry: Samples, truth: Samples) -> float:
    """Return the threshold, rad/s, below which an odometry's yaw rate reads exactly zero; 0 if there is no such band.

    The smallest reported turns are far from zero and are no multiples of a step. In motion many are exactly zero, and
    the truth turns meanwhile; a robot whose commands have a least turn does not. The truth needs headings.
    """
    if not truth.headed or len(odometry.stamps_ns) < _FEWEST:
        return 0.0
    t_s = odometry.t_s
    steps = increments(odometry.trajectory().xyt)
    turn = np.abs(steps.dtheta_rad)
    turning = turn[turn > _ZERO_RAD]
    least = float(turning.min(initial=np.inf))
    if least < _CLEAR * _ZERO_RAD:
        return 0.0
    above = turning[turning < 2.0 * least] / least - 1.0
    between = (above > _EDGE) & (above < 1.0 - _EDGE)
    if len(above) < _FEWEST or np.mean(between) < _SPREAD:
        return 0.0
    threshold = least / float(np.median(np.diff(t_s)))
    zero = (turn <= _ZERO_RAD) & (np.abs(steps.ds_m) > _ZERO_M)
    origin_ns = int(odometry.stamps_ns[0])
    lost = _turns_within(t_s, steps.ds_m, zero, truth, origin_ns, threshold) or _misses_slow_turns(
        t_s, steps.dtheta_rad, zero, truth, origin_ns, threshold
    )
    return threshold if lost else 0.0


def _turns_within(
    t_s: Array, ds_m: Array, zero: NDArray[np.bool_], truth: Samples, origin_ns: int, threshold: float
) -> bool:
    """Return whether the truth turns while the odometry's intervals `zero` (n - 1,) last, beyond the truth's noise.

    Turns in proportion to the travel or to time do not count: unequal wheels and a bias turn a robot whose command is
    straight.
    """
    edges = np.flatnonzero(np.diff(np.concatenate(([0], zero, [0]))))
    first, last = t_s[edges[::2]], t_s[edges[1::2]]
    own = truth.seconds_since(origin_ns)
    long = (last - first >= _RUN_S) & (first >= own[0]) & (last <= own[-1])
    if np.count_nonzero(long) < _RUNS:
        return False
    heading = np.unwrap(truth.yaw_rad)
    turned = np.interp(last[long], own, heading) - np.interp(first[long], own, heading)
    way = np.concatenate(([0.0], np.cumsum(ds_m)))
    travel = np.interp(last[long], t_s, way) - np.interp(first[long], t_s, way)
    steady = np.stack((travel, (last - first)[long]), axis=1)
    turned = turned - steady @ np.linalg.lstsq(steady, turned, rcond=None)[0]
    # 0.4549 is the median of chi-square with 1 degree of freedom; second differences have 6 variances, turns 2
    noise = 2.0 * float(np.median(np.diff(heading, n=2) ** 2)) / 0.4549 / 6.0
    seen = float(np.mean(turned**2)) - noise
    lasted_s = float(np.sqrt(np.mean((last[long] - first[long]) ** 2)))
    return seen > (_ERRORS - 1.0) * noise and seen > (_TURNS * threshold * lasted_s) ** 2


def _misses_slow_turns(
    t_s: Array, turn: Array, zero: NDArray[np.bool_], truth: Samples, origin_ns: int, threshold: float
) -> bool:
    """Return whether the truth turns farther than the odometry, in the same direction, where turns are slow.

    The robot's own jitter lifts a part of its yaw rates above the threshold, so that zeros do not last.

    turn, zero : (n - 1,) turns of the odometry, rad, and whether they are zero in motion
    """
    own = truth.seconds_since(origin_ns)
    ends = np.arange(max(t_s[0], own[0]), min(t_s[-1], own[-1]), _RUN_S)
    if len(ends) < _FEWEST:
        return False
    reported, zeros = (
        np.diff(np.interp(ends, t_s, np.concatenate(([0.0], np.cumsum(part))))) for part in (turn, zero * np.diff(t_s))
    )
    missed = np.diff(np.interp(ends, own, np.unwrap(truth.yaw_rad))) - reported
    slow = (np.abs(reported) < threshold * _RUN_S) & (zeros > _SOME * _RUN_S)
    x, y = reported[slow], missed[slow]
    if len(x) < _FEWEST or not x.any():
        return False
    ratio = float(x @ y) / float(x @ x)
    error = float(np.sqrt(np.mean((y - ratio * x) ** 2) / (x @ x)))
    return ratio > max(_MISSING, _SURE * error)

"""Dead band of a gyro: yaw rates below a threshold are reported as exactly zero, although the robot turns."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import increments

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array, Increments
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
_WINDOW_S, _ZEROS, _WINDOWS = 2.0, 0.3, 10
"""Length of windows in which turns are compared, s; least share of zeros in motion in them; their fewest number."""
_TURNS, _ERRORS = 0.1, 2.0
"""Least root mean square of the unreported yaw rate, as a fraction of the threshold, and of its mean square, as a
multiple of that of the truth's noise."""


def yaw_dead_band(odometry: Samples, truth: Samples) -> float:
    """Return the threshold, rad/s, below which an odometry's yaw rate reads exactly zero; 0 if there is no such band.

    The smallest reported turns are far from zero and are no multiples of a step. In motion many are exactly zero, and
    the truth turns meanwhile; a robot whose commands have a least turn does not. The truth needs headings.
    """
    if not truth.headed or len(odometry.stamps_ns) < _FEWEST:
        return 0.0
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
    threshold = least / float(np.median(np.diff(odometry.t_s)))
    zero = (turn <= _ZERO_RAD) & (np.abs(steps.ds_m) > _ZERO_M)
    return threshold if _turns_unreported(odometry, steps, zero, truth, threshold) else 0.0


def _turns_unreported(
    odometry: Samples, steps: Increments, zero: NDArray[np.bool_], truth: Samples, threshold: float
) -> bool:
    """Return whether the truth turns otherwise than reported where turns are slow and often `zero` (n - 1,) in motion.

    Turns in proportion to the travel or to time do not count: unequal wheels and a bias turn a robot whose command is
    straight.
    """
    t_s, own_s, heading = odometry.t_s, truth.seconds_since(int(odometry.stamps_ns[0])), np.unwrap(truth.yaw_rad)
    ends = np.arange(max(t_s[0], own_s[0]), min(t_s[-1], own_s[-1]), _WINDOW_S)

    def within(change: Array) -> Array:
        return np.diff(np.interp(ends, t_s, np.concatenate(([0.0], np.cumsum(change)))))

    reported = within(steps.dtheta_rad)
    slow = (np.abs(reported) < threshold * _WINDOW_S) & (within(zero * np.diff(t_s)) > _ZEROS * _WINDOW_S)
    if np.count_nonzero(slow) < _WINDOWS:
        return False
    missed = (np.diff(np.interp(ends, own_s, heading)) - reported)[slow]
    steady = np.column_stack((within(steps.ds_m)[slow], np.ones(len(missed))))
    missed -= steady @ np.linalg.lstsq(steady, missed, rcond=None)[0]
    # 0.4549 is the median of chi-square with 1 degree of freedom; second differences have 6 variances, turns 2
    noise = 2.0 * float(np.median(np.diff(heading, n=2) ** 2)) / 0.4549 / 6.0
    seen = float(np.mean(missed**2)) - noise
    return seen > _ERRORS * noise and seen > (_TURNS * threshold * _WINDOW_S) ** 2

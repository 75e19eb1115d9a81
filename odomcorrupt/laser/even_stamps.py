"""Evenly spaced stamps from stamps of arrival: a laser turns at a nearly constant rate, its messages are delayed."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

_GAP = 2.5
"""Gap in usual sweep periods, over which sweeps are not counted."""
_FEWEST = 10
"""Smallest number of sweeps on each side over which the rate is taken as constant."""


def even_stamps(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return stamps (n,) on lines fitted to the n increasing stamps as a function of the sweep's number.

    Each line is over as many sweeps on both sides, or to the next gap. That number is the one with which stamps are
    predicted best from the others (leave-one-out cross-validation): a longer line averages more delays, and a shorter
    one follows a laser whose rate drifts.
    """
    n = len(stamps_ns)
    if n < 2:
        return stamps_ns
    steps = np.diff(stamps_ns)
    period = float(np.median(steps))
    broken = np.flatnonzero(steps > _GAP * period)
    first, last = np.append(0, broken + 1), np.append(broken, n - 1)
    stretch = np.searchsorted(last, np.arange(n))
    # deviations from one line keep the sums below small
    late = (stamps_ns - stamps_ns[0]).astype(np.float64) - period * np.arange(n)
    best, least = late, np.inf
    half = _FEWEST
    while True:
        smooth, share = _lines(late, first[stretch], last[stretch], half)
        miss = float(np.mean(np.abs(late - smooth) / np.maximum(1.0 - share, 1e-9)))
        if miss < least:
            best, least = smooth, miss
        if half > n:
            break
        half *= 2
    return stamps_ns + np.round(best - late).astype(np.int64)


def _lines(late: Array, first: NDArray[np.int64], last: NDArray[np.int64], half: int) -> tuple[Array, Array]:
    """Return the values (n,) of lines through windows at their sweeps, and the share of the sweep's own value in each.

    first, last : (n,) first and last sweep of the stretch without gaps that each sweep is in
    """
    rows = np.arange(len(late))
    begin, end = np.maximum(rows - half, first), np.minimum(rows + half, last) + 1

    def total(values: Array) -> Array:
        sums = np.concatenate(([0.0], np.cumsum(values)))
        return sums[end] - sums[begin]

    count = (end - begin).astype(np.float64)
    middle = 0.5 * (begin + end - 1)
    spread = np.maximum(count * (count**2 - 1.0) / 12.0, 0.5)
    mean = total(late) / count
    slope = (total(late * rows) - middle * total(late)) / spread
    aside = rows - middle
    return mean + slope * aside, 1.0 / count + aside**2 / spread

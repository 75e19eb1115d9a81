"""Covariance of window errors from correlated random effects."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect, Gain, Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.intervals import Intervals

__all__ = ["random_covariance"]


def random_covariance(random: Sequence[Effect], windows: Intervals, motion: Motion) -> Array:
    """Return the covariance (K, 3, 3) from random gains on each window of one run.

    A gain g is a Markov process: Cov(g_i, g_j) is Var(g_i) times the product of the factors kept from i to j. With c_i
    the effect of step i at the window's end, the sum over all pairs therefore takes one backward pass.
    """
    total = np.zeros((len(windows), 3, 3))
    for effect in random:
        for gain in effect.gains(motion):
            total += _of_gain(gain, windows, motion)
    return total


def _of_gain(gain: Gain, windows: Intervals, motion: Motion) -> Array:
    moved = windows.carried(gain.f * motion.dt_s[:, None])
    keep = gain.keep[windows.source] ** windows.share
    variance = _variances(gain)[windows.source]
    last = np.zeros(len(keep), dtype=bool)
    last[np.concatenate((windows.first[1:] - 1, [len(keep) - 1]))] = True
    later = np.zeros_like(moved)
    sums = [0.0, 0.0, 0.0]
    rows = zip(*moved.tolist(), keep.tolist(), last.tolist(), strict=True)
    for place, (along, across, yaw, kept, ends) in reversed(list(enumerate(rows))):
        if ends:
            sums = [0.0, 0.0, 0.0]
        later[:, place] = sums
        sums = [kept * (s + c) for s, c in zip(sums, (along, across, yaw), strict=True)]
    both = moved[:, None] * (later + 0.5 * moved)[None]
    outer = variance * (both + np.swapaxes(both, 0, 1))
    return np.ascontiguousarray(np.moveaxis(np.add.reduceat(outer, windows.first, axis=2), 2, 0))


def _variances(gain: Gain) -> Array:
    """Return the variance (n,) of the gain in each interval."""
    variance, found = gain.start, []
    for keep, kick in zip(gain.keep.tolist(), gain.kick.tolist(), strict=True):
        variance = keep * keep * variance + kick
        found.append(variance)
    return np.array(found)

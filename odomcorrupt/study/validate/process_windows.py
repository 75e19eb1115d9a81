"""Errors of windows by random effects: their covariance in each window, and what windows share by slow processes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE, prior_root, processes_like

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect, Motion, RandomCoefficient
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.intervals import Intervals

_PER_TIME, _MOST_KNOTS = 8.0, 200
"""Knots per correlation time, and their largest number: a process that is faster is hardly common to two windows."""


def process_roots(random: Sequence[Effect], windows: Intervals, motion: Motion) -> Array | None:
    """Return a root (n, 3, m) of the covariance of the errors of n windows of one run by Markov processes, or None.

    A gain or bias that changes slowly is nearly the same in successive windows, so that their errors are no independent
    evidence against its size.

    random : random effects of a model; those without memory over windows are left out
    motion : motion of the run
    """
    roots = []
    for effect in random:
        if effect.name not in CORRELATED_NOISE:
            continue
        (process,) = processes_like(effect)
        span_s = float(motion.t_s[-1] - motion.t_s[0])
        step_s = max(process.memory_s / _PER_TIME, span_s / _MOST_KNOTS)
        knots_s = motion.t_s[0] + np.arange(int(span_s / step_s) + 2) * step_s
        change = process.unit(motion) * motion.dt_s[:, None]
        columns = []
        for knot_s in knots_s:
            weight = np.maximum(1.0 - np.abs(motion.t_s - knot_s) / step_s, 0.0)
            columns.append(windows.column(change * weight[:, None]))
        scale = getattr(effect, process.scale)
        roots.append(np.stack(columns, axis=2) @ (scale * prior_root(process, np.diff(knots_s))))
    return np.concatenate(roots, axis=2) if roots else None


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


def _of_gain(gain: RandomCoefficient, windows: Intervals, motion: Motion) -> Array:
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


def _variances(gain: RandomCoefficient) -> Array:
    """Return the variance (n,) of the gain in each interval."""
    variance, found = gain.start, []
    for keep, kick in zip(gain.keep.tolist(), gain.kick.tolist(), strict=True):
        variance = keep * keep * variance + kick
        found.append(variance)
    return np.array(found)

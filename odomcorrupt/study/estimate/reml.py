"""The climb to a likelihood's top: Newton's steps with the average information, within a box and a reach of trust.

The average of observed and expected information needs no second derivatives and is never negative; near the top its
steps are nearly Newton's (Gilmour, Thompson & Cullis 1995). It changes slowly, so it is taken anew only where the
steps do not gain what they promise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple, Protocol

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.noise_likelihood import NoiseFit

__all__ = ["Box", "climbed"]

_MOST = 60
_FAR, _NEAREST = 3.0, 1e-3
"""Largest and smallest reach of a step, in logarithms."""
_AS_PROMISED = 0.2
"""A step that gains its promise within this part needs no new information."""
_RIDGE = 1e-6
_SWEEPS, _STILL = 40, 1e-3
_BENDS = (0.7, 3.0)
"""Curvature along a step over what the information tells, as far as it is believed."""


class Box(NamedTuple):
    """Bounds (m,) of what is climbed along; a number whose bounds meet is held."""

    low: Array
    high: Array


class _Hill(Protocol):
    def evaluate(self, free: Array) -> NoiseFit:
        """Return the fit at given noise."""

    def slope(self, done: NoiseFit, movable: NDArray[np.int64]) -> Array:
        """Return the slope in the numbers that may move."""

    def information(self, done: NoiseFit, movable: NDArray[np.int64]) -> Array:
        """Return their average information."""


def climbed(hill: _Hill, begin: Array, box: Box, enough: float) -> Array:
    """Return the top that is reached from a beginning, to within a step that promises less than `enough` nats."""
    movable = np.flatnonzero(box.low < box.high)
    done, reach, bend = hill.evaluate(begin), _FAR, 1.0
    slope, information, fresh = (hill.slope(done, movable), hill.information(done, movable), True)
    for _ in range(_MOST):
        here = done.free[movable]
        room = (np.maximum(box.low[movable] - here, -reach), np.minimum(box.high[movable] - here, reach))
        step = _best_step(slope, bend * information, *room)
        promise = float(slope @ step - 0.5 * bend * step @ information @ step)
        if promise < enough:
            # the information is fresh, or its last promise was kept
            break
        free = done.free.copy()
        free[movable] += step
        new = hill.evaluate(np.clip(free, box.low, box.high))
        gain = new.log_likelihood - done.log_likelihood
        if gain > 0.0:
            done, before, slope = new, slope, hill.slope(new, movable)
            reach = min(2.0 * reach, _FAR)
            # outliers bend the top more than the average tells, and what they bend is steep
            bend = float(np.clip((before - slope) @ step / (step @ information @ step), *_BENDS))
            if abs(gain - promise) < _AS_PROMISED * promise:
                fresh = False
                continue
        elif fresh:
            reach = 0.3 * min(reach, float(np.abs(step).max()))
            if reach < _NEAREST:
                break
            continue
        information, fresh = hill.information(done, movable), True
    return done.free


def _best_step(slope: Array, information: Array, low: Array, high: Array) -> Array:
    """Return the step (m,) to the top of a parabola within bounds that hold zero."""
    whole = information + _RIDGE * np.eye(len(slope))
    step = np.linalg.solve(whole, slope)
    inside: Array = np.clip(step, low, high)
    if np.array_equal(inside, step):
        return inside
    # one number after the other: each goes as far as the others, where they now are, let it
    for _ in range(_SWEEPS):
        before = inside.copy()
        for i in range(len(slope)):
            inside[i] += (slope[i] - whole[i] @ inside) / whole[i, i]
            inside[i] = min(max(inside[i], low[i]), high[i])
        if np.abs(inside - before).max() < _STILL:
            break
    return inside

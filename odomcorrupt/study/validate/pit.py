"""Probability integral transform: where in its predicted distribution every innovation fell.

Under the right model these places are uniform. What is drawn is their empirical distribution less the uniform one, in
a band that 95 % of right models stay inside of *everywhere* at once (Säilynoja, Bürkner & Vehtari, Statistics and
Computing 32:32, 2022: the pointwise level is found by simulation).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import binom, norm

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

__all__ = ["PIT_LEVEL", "Pit", "pit_of"]

PIT_LEVEL = 0.95
_GRID = 50
_SIMULATIONS = 4000
_SEED = 20_220_325
"""The simulation is part of the method: the same data give the same band."""


@dataclass(frozen=True, slots=True)
class Pit:
    """Places of one channel's n innovations.

    at : (g,) the places looked at, inside (0, 1)
    difference : (g,) part of the innovations below that place, less the place itself
    low, high : (g,) the simultaneous band of the difference
    p : probability that a right model leaves the uniform as far as this one, anywhere
    """

    at: Array
    difference: Array
    low: Array
    high: Array
    p: float

    @property
    def inside(self) -> bool:
        """Whether the difference stays in its band everywhere."""
        return bool(np.all((self.difference >= self.low) & (self.difference <= self.high)))


def pit_of(innovations: Array) -> Pit:
    """Return where standardised innovations (n,) fell in a standard normal."""
    at = np.arange(1, _GRID) / _GRID
    count = len(innovations)
    below = np.searchsorted(np.sort(norm.cdf(innovations)), at, side="right")
    simulated = _least_tails(count)
    observed = _tail(np.asarray(below, dtype=np.int64)[None], at, count)[0]
    # with the observation itself counted, p is valid and never zero
    p = float((1 + np.sum(simulated <= observed)) / (1 + len(simulated)))
    tail = float(np.quantile(simulated, 1.0 - PIT_LEVEL)) / 2.0
    low, high = binom.ppf(tail, count, at) / count - at, binom.isf(tail, count, at) / count - at
    return Pit(at, below / count - at, low, high, p)


@lru_cache(maxsize=64)
def _least_tails(count: int) -> Array:
    """Return, per simulated right model, how unlikely its most unlikely point is by itself."""
    rng = np.random.default_rng(_SEED)
    below = np.cumsum(rng.multinomial(count, np.full(_GRID, 1.0 / _GRID), size=_SIMULATIONS), axis=1)[:, :-1]
    return _tail(below, np.arange(1, _GRID) / _GRID, count)


def _tail(below: NDArray[np.int64], at: Array, count: int) -> Array:
    """Return the smallest two-sided pointwise probability (s,) of counts (s, g)."""
    either = np.minimum(binom.cdf(below, count, at), binom.sf(below - 1, count, at))
    least: Array = 2.0 * np.min(either, axis=1)
    return least

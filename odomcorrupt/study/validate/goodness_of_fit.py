"""Goodness of fit of a model: sizes of errors, distribution and whiteness of innovations, one level for all tests.

Probability integral transform (PIT): under the right model the place of every innovation in its predicted distribution
is uniform. What is drawn is the empirical distribution of these places less the uniform one, in a band that 95 % of
right models stay inside of everywhere at once (Säilynoja, Bürkner & Vehtari, Statistics and Computing 32:32, 2022: the
pointwise level is found by simulation). Whiteness: innovations of a right model do not depend on the ones before them;
Ljung & Box 1978, Biometrika 65, 297-303, per channel.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import binom, chi2, norm

from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.validate.error_rates import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.validate.calibration import Horizon

__all__ = [
    "LAGS",
    "PIT_LEVEL",
    "PRACTICAL_FACTOR",
    "REJECTION_LEVEL",
    "Check",
    "Pit",
    "Verdict",
    "Whiteness",
    "ljung_box",
    "pit_of",
    "pits_of",
    "verdict_of",
    "whiteness_of",
]

REJECTION_LEVEL = 0.05
"""Probability of rejecting a right model, all looks together."""
PRACTICAL_FACTOR = 1.25
"""Errors within this factor of the predicted ones: a model that is right about sizes. Noise of one robot differs by as
much from one floor to another."""
PRACTICAL_PER_M = DECISIONS.practical.per_m
"""Errors that differ from the predicted ones by less, m per metre of path, do not matter whatever their factor."""
PIT_LEVEL = 0.95
_GRID = 50
_SIMULATIONS = 4000
_SEED = 20_220_325
"""The simulation is part of the method: the same data give the same band."""
LAGS = 20


@dataclass(frozen=True, slots=True)
class Check:
    """One test of fit: its question, and its p-value."""

    question: str
    p: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """All looks, the worst first; rejected where one is worse than the level divided by their number (Bonferroni).

    misfit : how many times larger than predicted the errors are where they are farthest from it beyond chance, below 1
        where they are smaller; 1 where all are as predicted
    """

    level: float
    checks: tuple[Check, ...]
    misfit: float = inf

    @property
    def threshold(self) -> float:
        """What a single look must fall below."""
        return self.level / max(len(self.checks), 1)

    @property
    def against(self) -> tuple[Check, ...]:
        """The looks that reject the model."""
        return tuple(look for look in self.checks if look.p < self.threshold)

    @property
    def rejected(self) -> bool:
        """Whether the model is rejected."""
        return bool(self.against)

    @property
    def fails(self) -> bool:
        """Whether it is rejected, and errors are larger or smaller than predicted by a factor that matters.

        With enough data every model is rejected for something; one that predicts all sizes is of use.
        """
        return self.rejected and not 1.0 / PRACTICAL_FACTOR <= self.misfit <= PRACTICAL_FACTOR


def pits_of(chains: Sequence[Array], axes: Sequence[int] = (0, 1, 2)) -> dict[str, Pit]:
    """Return the PIT of every channel of chains of innovations (m, c), whose columns are these axes."""
    rows = np.concatenate(chains)
    return {CHANNELS[axes[c]]: pit_of(rows[:, c]) for c in range(rows.shape[1])}


def whiteness_of(chains: Sequence[Array], axes: Sequence[int] = (0, 1, 2)) -> dict[str, Whiteness]:
    """Return the whiteness of every channel of chains, whose columns are these axes."""
    return {CHANNELS[axes[c]]: ljung_box([chain[:, c] for chain in chains]) for c in range(chains[0].shape[1])}


def verdict_of(horizons: Sequence[Horizon], pits: Mapping[str, Pit], whiteness: Mapping[str, Whiteness]) -> Verdict:
    """Weigh all looks."""
    beyond = [h.nees for h in horizons if not h.nees_bounds[0] <= h.nees <= h.nees_bounds[1] and _is_seen(h)]
    misfit = float(np.sqrt(max(beyond, key=lambda nees: abs(np.log(max(nees, 1e-300)))))) if beyond else 1.0
    looks = [Check(f"size of errors over {h.distance_m:g} m of path (NEES)", h.nees_p) for h in horizons]
    looks += [Check(f"distribution of {name} innovations (PIT)", pit.p) for name, pit in pits.items()]
    looks += [Check(f"memory of {name} innovations (Ljung-Box)", white.p) for name, white in whiteness.items()]
    return Verdict(REJECTION_LEVEL, tuple(sorted(looks, key=lambda look: look.p)), misfit)


def _is_seen(h: Horizon) -> bool:
    """Tell whether measured and predicted errors differ by a length that matters, where positions were measured."""
    apart_m2 = abs(h.position_measured**2 - h.position_expected**2)
    return not apart_m2 < (PRACTICAL_PER_M * h.distance_m) ** 2


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


@dataclass(frozen=True, slots=True)
class Whiteness:
    """Autocorrelation of one channel.

    correlation : (lags,) at lags 1, 2, ... intervals
    statistic : Ljung and Box's Q, chi-square with as many degrees as lags where innovations are white
    """

    correlation: Array
    statistic: float
    p: float


def ljung_box(chains: Sequence[Array], lags: int = LAGS) -> Whiteness:
    """Test innovations (n,) of unbroken chains; no pair is made across a break."""
    count = sum(len(chain) for chain in chains)
    mean = sum(float(chain.sum()) for chain in chains) / max(count, 1)
    centred = [chain - mean for chain in chains]
    power = sum(float(chain @ chain) for chain in centred)
    if count <= lags + 1 or power <= 0.0:
        return Whiteness(np.full(lags, np.nan), float("nan"), 1.0)
    rho = np.array([sum(float(c[k:] @ c[:-k]) for c in centred if len(c) > k) / power for k in range(1, lags + 1)])
    statistic = float(count * (count + 2.0) * np.sum(rho**2 / (count - np.arange(1, lags + 1))))
    return Whiteness(rho, statistic, float(chi2.sf(statistic, lags)))

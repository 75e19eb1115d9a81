"""Goodness of fit of a model: sizes of errors, distribution and whiteness of innovations, one level for all tests.

Probability integral transform (PIT): under a correct model the quantiles of the innovations in their predicted
distributions are uniform. Plotted is their empirical distribution minus the uniform one, with a band that contains the
whole curve for 95 % of correct models (Säilynoja, Bürkner & Vehtari, Statistics and Computing 32:32, 2022; the
pointwise level is found by simulation). Whiteness: innovations of a correct model are independent of earlier ones
(Ljung & Box 1978, Biometrika 65, 297-303, per channel).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import inf
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import binom, chi2, norm

from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.study.validate.lack_of_fit import CHANNELS

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.validate.calibration import Horizon

REJECTION_LEVEL = 0.05
"""Probability of rejecting a correct model by any of the tests."""
PRACTICAL_FACTOR = 1.25
"""Ratio of measured to predicted errors within which a model counts as calibrated. The noise of one robot differs by
as much between floors."""
PRACTICAL_PER_M = DECISIONS.practical.per_m
"""Differences between measured and predicted errors below this, m per metre of path, are irrelevant at any ratio."""
PIT_LEVEL = 0.95
_GRID = 50
_SIMULATIONS = 4000
_SEED = 20_220_325
"""Fixed, so that the same data give the same band."""
LAGS = 20


@dataclass(frozen=True, slots=True)
class Check:
    """One test of fit: the tested property, and its p-value."""

    question: str
    p: float


@dataclass(frozen=True, slots=True)
class Verdict:
    """All tests, the smallest p-value first; rejected if one is below the level divided by their number (Bonferroni).

    misfit : ratio of measured to predicted errors over the path length that deviates most, of those that deviate beyond
        the chance of all of them together; below 1 if the errors are smaller; 1 if none deviates
    """

    level: float
    checks: tuple[Check, ...]
    misfit: float = inf

    @property
    def threshold(self) -> float:
        """Level of a single test."""
        return self.level / max(len(self.checks), 1)

    @property
    def against(self) -> tuple[Check, ...]:
        """The tests that reject the model."""
        return tuple(check for check in self.checks if check.p < self.threshold)

    @property
    def rejected(self) -> bool:
        """Whether the model is rejected."""
        return bool(self.against)

    @property
    def fails(self) -> bool:
        """Whether the model is rejected and its predicted errors are wrong by a relevant factor.

        With enough data every model is rejected by some test; one that predicts all sizes is still useful.
        """
        return self.rejected and not 1.0 / PRACTICAL_FACTOR <= self.misfit <= PRACTICAL_FACTOR


def pits_of(chains: Sequence[Array], axes: Sequence[int] = (0, 1, 2)) -> dict[str, Pit]:
    """Return the PIT of every channel of chains of innovations (m, c), whose columns are the given axes."""
    rows = np.concatenate(chains)
    return {CHANNELS[axes[c]]: pit_of(rows[:, c]) for c in range(rows.shape[1])}


def whiteness_of(chains: Sequence[Array], axes: Sequence[int] = (0, 1, 2)) -> dict[str, Whiteness]:
    """Return the whiteness of every channel of chains of innovations, whose columns are the given axes."""
    return {CHANNELS[axes[c]]: ljung_box([chain[:, c] for chain in chains]) for c in range(chains[0].shape[1])}


def size_question(distance_m: float) -> str:
    """Return what the test of the sizes of errors over one path length asks."""
    return f"size of errors over {distance_m:g} m of path (NEES)"


def verdict_of(horizons: Sequence[Horizon], pits: Mapping[str, Pit], whiteness: Mapping[str, Whiteness]) -> Verdict:
    """Return the joint verdict of all tests."""
    # each length has its chance to deviate: only sizes beyond the chance of all of them together count
    apart = [abs(h.position_measured**2 - h.position_expected**2) for h in horizons]  # NaN if none were measured
    seen = [h for h, m2 in zip(horizons, apart, strict=True) if not m2 < (PRACTICAL_PER_M * h.distance_m) ** 2]
    beyond = [h.nees for h in seen if h.nees_p * len(horizons) < REJECTION_LEVEL]
    misfit = float(np.sqrt(max(beyond, key=lambda nees: abs(np.log(max(nees, 1e-300)))))) if beyond else 1.0
    checks = [Check(size_question(h.distance_m), h.nees_p) for h in horizons]
    checks += [Check(f"distribution of {name} innovations (PIT)", pit.p) for name, pit in pits.items()]
    checks += [Check(f"autocorrelation of {name} innovations (Ljung-Box)", one.p) for name, one in whiteness.items()]
    return Verdict(REJECTION_LEVEL, tuple(sorted(checks, key=lambda check: check.p)), misfit)


@dataclass(frozen=True, slots=True)
class Pit:
    """Quantiles of one channel's n innovations in their predicted distribution.

    at : (g,) levels inside (0, 1)
    difference : (g,) fraction of the quantiles below each level, minus the level
    low, high : (g,) simultaneous band of the difference
    p : probability of a deviation at least as large, at any level, under a correct model
    """

    at: Array
    difference: Array
    low: Array
    high: Array
    p: float

    @property
    def inside(self) -> bool:
        """Whether the difference is inside its band at every level."""
        return bool(np.all((self.difference >= self.low) & (self.difference <= self.high)))


def pit_of(innovations: Array) -> Pit:
    """Return the PIT of standardised innovations (n,) in a standard normal distribution."""
    at = np.arange(1, _GRID) / _GRID
    count = len(innovations)
    below = np.searchsorted(np.sort(norm.cdf(innovations)), at, side="right")
    simulated = _least_tails(count)
    observed = _tail(np.asarray(below, dtype=np.int64)[None], at, count)[0]
    # Counting the observation itself makes the p-value valid and never zero.
    p = float((1 + np.sum(simulated <= observed)) / (1 + len(simulated)))
    tail = float(np.quantile(simulated, 1.0 - PIT_LEVEL)) / 2.0
    low, high = binom.ppf(tail, count, at) / count - at, binom.isf(tail, count, at) / count - at
    return Pit(at, below / count - at, low, high, p)


@lru_cache(maxsize=64)
def _least_tails(count: int) -> Array:
    """Return the smallest pointwise p-value of each simulated correct model."""
    rng = np.random.default_rng(_SEED)
    below = np.cumsum(rng.multinomial(count, np.full(_GRID, 1.0 / _GRID), size=_SIMULATIONS), axis=1)[:, :-1]
    return _tail(below, np.arange(1, _GRID) / _GRID, count)


def _tail(below: NDArray[np.int64], at: Array, count: int) -> Array:
    """Return the smallest two-sided pointwise p-value (s,) of counts (s, g)."""
    either = np.minimum(binom.cdf(below, count, at), binom.sf(below - 1, count, at))
    return 2.0 * np.min(either, axis=1)


@dataclass(frozen=True, slots=True)
class Whiteness:
    """Autocorrelation of one channel.

    correlation : (lags,) at lags 1, 2, ... intervals
    statistic : Q of Ljung and Box, chi-square distributed with as many degrees of freedom as lags for white innovations
    """

    correlation: Array
    statistic: float
    p: float


def ljung_box(chains: Sequence[Array], lags: int = LAGS) -> Whiteness:
    """Return the Ljung-Box test of innovations (n,) in chains; no pair spans two chains."""
    count = sum(len(chain) for chain in chains)
    mean = sum(float(chain.sum()) for chain in chains) / max(count, 1)
    centred = [chain - mean for chain in chains]
    power = sum(float(chain @ chain) for chain in centred)
    if count <= lags + 1 or power <= 0.0:
        return Whiteness(np.full(lags, np.nan), float("nan"), 1.0)
    rho = np.array([sum(float(c[k:] @ c[:-k]) for c in centred if len(c) > k) / power for k in range(1, lags + 1)])
    statistic = float(count * (count + 2.0) * np.sum(rho**2 / (count - np.arange(1, lags + 1))))
    return Whiteness(rho, statistic, float(chi2.sf(statistic, lags)))

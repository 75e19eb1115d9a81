"""Statistics over runs: quantiles with exact intervals, growth with the drift, break-down point, errors by place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

LOST_PART = 0.05
"""Fraction of lost runs that defines the break-down point."""
_LOST_LOGIT = float(np.log(LOST_PART / (1.0 - LOST_PART)))


def quantile(values: Array, q: float) -> Array:
    """Return a quantile over the last axis of values, which may be infinite; linear between neighbours."""
    ordered = np.sort(values, axis=-1)
    at = q * (ordered.shape[-1] - 1)
    low, high = ordered[..., int(np.floor(at))], ordered[..., int(np.ceil(at))]
    with np.errstate(invalid="ignore"):
        return np.where(low == high, low, low + (at - np.floor(at)) * (high - low))


@dataclass(frozen=True, slots=True)
class Quantile:
    """A quantile over runs and its 95 % interval by order statistics; infinite if too few runs bound it."""

    value: float
    low: float
    high: float


@dataclass(frozen=True, slots=True)
class Summary:
    """Statistics of one metric over the n runs that have it: metres, radians or dimensionless."""

    n: int
    mean: float
    median: Quantile
    p90: Quantile
    p95: Quantile
    max: float


def summarise(values: Array) -> Summary:
    """Return mean, quantiles and maximum of values (n,), which may be infinite, ignoring NaN."""
    own = np.sort(values[~np.isnan(values)])
    if not len(own):
        nothing = Quantile(*[float("nan")] * 3)
        return Summary(0, float("nan"), nothing, nothing, nothing, float("nan"))
    return Summary(
        len(own), float(own.mean()), _quantile(own, 0.5), _quantile(own, 0.9), _quantile(own, 0.95), float(own[-1])
    )


def _quantile(ordered: Array, q: float) -> Quantile:
    """Return a quantile; its interval covers it with at least 95 % for any distribution (David & Nagaraja 2003)."""
    from scipy.special import bdtr  # noqa: PLC0415 - a gate of the pytest plugin needs no SciPy

    n = len(ordered)
    counts = bdtr(np.arange(n + 1), n, q)
    lower, upper = int(np.searchsorted(counts, 0.025, side="right")), int(np.searchsorted(counts, 0.975)) + 1
    low = float(ordered[lower - 1]) if lower >= 1 else 0.0
    high = float(ordered[upper - 1]) if upper <= n else float("inf")
    return Quantile(float(quantile(ordered, q)), low, high)


@dataclass(frozen=True, slots=True)
class Growth:
    """Growth of an error with the drift: proportional to drift to the power `exponent`, with its 95 % interval."""

    exponent: float
    low: float
    high: float


def growth(drift: Array, error: Array) -> Growth | None:
    """Return the exponent by least squares of logarithms over runs (n,); None below 8 runs or without a range of drift.

    Source of the interval: normal theory with the residuals' own variance.
    """
    usable = (drift > 0.0) & (error > 0.0) & np.isfinite(drift) & np.isfinite(error)
    x, y = np.log(drift[usable]), np.log(error[usable])
    if len(x) < 8 or np.ptp(x) < 0.1:
        return None
    dx = x - x.mean()
    slope = float(np.sum(dx * y) / np.sum(dx**2))
    rest = y - y.mean() - slope * dx
    deviation = float(np.sqrt(np.sum(rest**2) / (len(x) - 2) / np.sum(dx**2)))
    return Growth(slope, slope - 2.0 * deviation, slope + 2.0 * deviation)


@dataclass(frozen=True, slots=True)
class Breakdown:
    """The drift at which 5 % of runs are lost, not extrapolated beyond the drifts of the runs.

    drift : most likely value; 0 below the smallest drift of the runs, infinite beyond the largest, None of too few runs
    low, high : 95 % interval by profile likelihood; 0 and infinity where no runs were, or these do not bound it
    width : factor of drift between 5 and 50 % of lost runs; None without a value of `drift`
    """

    drift: float | None
    low: float
    high: float
    width: float | None


def breakdown(drift: Array, lost: NDArray[np.bool_]) -> Breakdown:
    """Return the break-down point of runs (n,) by logistic regression of losses on the logarithm of the drift.

    logit p = logit 0.05 + b (log d - log d5) with b > 0: more drift never helps. d5 is found on a grid, with b
    maximised at each point (profile likelihood), so that separable runs, or runs without losses, need no exception.
    Source: Cox & Snell, Analysis of Binary Data, 1989; intervals: Wilks, Ann. Math. Stat. 9, 1938.
    """
    usable = np.isfinite(drift) & (drift > 0.0)
    x, y = np.log(drift[usable]), lost[usable]
    if len(x) < 5:
        return Breakdown(None, 0.0, float("inf"), None)
    grid, slopes = np.linspace(x.min() - 3.0, x.max() + 3.0, 601), np.geomspace(0.3, 60.0, 40)
    every = np.stack([_log_likelihood(x, y, grid, slope) for slope in slopes])
    best = every.max(axis=0)
    # twice the decrease of the log likelihood at the ends of a 95 % interval of one parameter
    first, last = grid[np.flatnonzero(2.0 * (best.max() - best) <= 3.841)[[0, -1]]]
    low = 0.0 if first < x.min() else float(np.exp(min(first, x.max())))
    high = float("inf") if last > x.max() else float(np.exp(max(last, x.min())))
    # of a range of equal likelihood, the middle
    equal = np.flatnonzero(best >= best.max() - 1e-6)
    at = int(equal[len(equal) // 2])
    if y.all() or grid[at] < x.min():
        return Breakdown(0.0, 0.0, high, None)
    if not y.any() or grid[at] > x.max():
        return Breakdown(float("inf"), low, float("inf"), None)
    return Breakdown(float(np.exp(grid[at])), low, high, float(np.exp(-_LOST_LOGIT / slopes[every[:, at].argmax()])))


def _log_likelihood(x: Array, lost: NDArray[np.bool_], grid: Array, slope: float) -> Array:
    """Return log likelihoods (k,) of runs (n,) for break-down points (k,) and one slope."""
    z = _LOST_LOGIT + slope * (x[None, :] - grid[:, None])
    return -np.logaddexp(0.0, np.where(lost, -z, z)).sum(axis=1)


@dataclass(frozen=True, slots=True)
class Section:
    """A section of the path: begin and end (metres driven), its middle, and the errors of all runs in it.

    median_m, p90_m : statistics of the position error over runs, each run's mean in the section
    runs : number of runs in it
    failures : number of runs lost in it
    """

    from_m: float
    to_m: float
    xy_m: tuple[float, float]
    median_m: float
    p90_m: float
    runs: int
    failures: int


def sections(
    paths: list[tuple[Array, Array]], clean_m: Array, clean_xy: Array, lost_at_m: list[float]
) -> list[Section]:
    """Return errors along the path, in 20 sections of equal length.

    paths : for each run, metres driven (k,) and position error (k,)
    clean_m : (n,) metres driven along the truth
    clean_xy : (n, 2) positions along the truth
    lost_at_m : metres driven at which runs were lost
    """
    edges = np.linspace(0.0, float(clean_m[-1]), 21)
    found = []
    for begin, end in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        means = [float(e[m].mean()) for d, e in paths if (m := (d >= begin) & (d <= end)).any()]
        middle = min(int(np.searchsorted(clean_m, (begin + end) / 2.0)), len(clean_m) - 1)
        x, y = clean_xy[middle].tolist()
        median, p90 = np.quantile(means, (0.5, 0.9)).tolist() if means else (float("nan"), float("nan"))
        failures = sum(begin <= at < end or (at == end == edges[-1]) for at in lost_at_m)
        found.append(Section(begin, end, (x, y), median, p90, len(means), failures))
    return found

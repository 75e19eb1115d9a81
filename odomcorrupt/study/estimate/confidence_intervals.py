"""Profile-likelihood confidence intervals of the noise coefficients.

Coefficients are positive and their likelihoods are skewed, so a standard error alone would be wrong. The interval is
the range in which the profile likelihood is within 1.92 nats of its maximum (95 %); it may begin at zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from odomcorrupt.study.estimate.noise_fit import without_process
from odomcorrupt.study.estimate.noise_likelihood import HIGHEST, LOWEST, NoiseLikelihood
from odomcorrupt.study.estimate.variance_components import NAMES

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.intervals import Intervals

_DROP = float(chi2.ppf(0.95, 1)) / 2.0
_STEPS = 7


@dataclass(frozen=True, slots=True)
class Interval:
    """A coefficient with its 95 % interval; `low` is 0 if the data are compatible with no such noise."""

    name: str
    value: float
    low: float
    high: float

    @property
    def identifiable(self) -> bool:
        """Whether the drive bounds the coefficient from above."""
        return self.high < HIGHEST

    @property
    def standard_error(self) -> float:
        """Symmetric standard error equivalent to the interval; from its lower side if the upper one is unbounded."""
        if not isfinite(self.high):
            return (self.value - self.low) / 1.96
        return (self.high - self.low) / (2.0 * 1.96)


def coefficient_intervals(fitted: Fit, columns: Array) -> list[Interval]:
    """Return the interval of each coefficient of the noise law, in the order of `NAMES`; columns are those of the fit.

    A coefficient that the drive does not excite (noise of turns without any turn) has no upper bound.
    """
    problem, noise = fitted.problem, fitted.noise

    def over(intervals: Intervals) -> NoiseLikelihood:
        return NoiseLikelihood(intervals, fitted.components, columns, noise.weights, headings=problem.headings)

    likelihood, free = over(problem.intervals), noise.free
    # with a localisation as the truth, noise was fitted with a prior: compare with that fit
    alone = any(r.localised for r in problem.recordings)
    if fitted.random:  # otherwise their contribution would be fitted as noise of each step
        likelihood = over(without_process(likelihood.evaluate(free), problem, columns, fitted.random))
        free, alone = likelihood.maximise(free).free, True
    top = likelihood.posterior(likelihood.evaluate(free)) if alone else fitted.log_likelihood
    found = []
    for position, index in enumerate(fitted.components.active):
        value = float(getattr(noise.coefficients, NAMES[index]))
        low, high = (_edge(likelihood, free, position, direction, top) for direction in (-1.0, 1.0))
        found.append(Interval(NAMES[index], value, min(low, value), max(high, value)))
    found += [Interval(NAMES[index], 0.0, 0.0, float("inf")) for index in fitted.components.unseen]
    return sorted(found, key=lambda interval: NAMES.index(interval.name))


def _edge(likelihood: NoiseLikelihood, start: Array, position: int, direction: float, top: float) -> float:
    """Return the value at which the profile has dropped by the quantile: doubling steps, then interpolation."""
    free, best = start.copy(), float(start[position])
    inside, inside_drop = max(best, np.log(1e-4)) if direction > 0 else best, 0.0
    step = 0.1
    for _ in range(_STEPS + 3):
        outside = inside + direction * step
        if outside <= np.log(LOWEST):
            return 0.0
        if outside >= np.log(HIGHEST):
            return float("inf")
        free[position] = outside
        profiled = likelihood.maximise(free, fixed=position)
        drop = top - likelihood.posterior(profiled)
        if drop >= _DROP:
            # a parabola in the logarithm between the two points
            share = (np.sqrt(_DROP) - np.sqrt(max(inside_drop, 0.0))) / (np.sqrt(drop) - np.sqrt(max(inside_drop, 0.0)))
            return float(np.exp(inside + share * (outside - inside)))
        free, inside, inside_drop = profiled.free, outside, drop
        step *= 2.0
    return 0.0 if direction < 0 else float("inf")

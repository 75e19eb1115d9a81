"""Correlation matrix of the estimation errors of a fitted model's parameters.

The errors of mean parameters (effects) and of variance parameters (noise) are independent to first order: the
information matrix of a Gaussian likelihood has no block between the two. So there are two blocks. That of the effects
comes from the normal equations, with clocks and mountings free. That of the noise comes from the curvature of the
profile likelihood in the logarithms of the coefficients, with the noise of the truth free.
"""

from __future__ import annotations

from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.model.correlation import Correlation
from odomcorrupt.study.estimate.noise_likelihood import LOWEST, NoiseLikelihood
from odomcorrupt.study.estimate.variance_components import NAMES

if TYPE_CHECKING:
    from collections.abc import Container

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit

__all__ = ["fit_correlation"]

_STEP = 0.05
"""Step of a finite difference in a log coefficient: above the likelihood's rounding, within its parabola."""


def fit_correlation(fitted: Fit, columns: Array, known: Container[str]) -> Correlation:
    """Return the correlations between the parameters for which a model file has standard errors.

    columns : (K, 3, q) design matrix of the fit, see `Fit.design_matrix`
    known : names of the standard errors that the file keeps
    """
    names = [f"{effect.name}.{p.name}" for effect in fitted.effects for p in amplitudes(effect)]
    effects = fitted.noise.theta_covariance[: len(names), : len(names)]
    noise_names, noise = _noise_covariance(fitted, columns)
    whole = np.zeros((len(noise_names) + len(names),) * 2)
    whole[: len(noise_names), : len(noise_names)] = noise
    whole[len(noise_names) :, len(noise_names) :] = effects
    every = Correlation.of_covariance([*noise_names, *names], whole)
    return every.among([name for name in every.names if name in known])


def _noise_covariance(fitted: Fit, columns: Array) -> tuple[list[str], Array]:
    """Return the names of the non-zero coefficients and the covariance (n, n) of their logarithms.

    The covariance is all zeros (unknown) if the likelihood has no maximum at the fitted values.
    """
    active, best = fitted.components.active, fitted.noise.free
    positions = [i for i in range(len(active)) if best[i] > np.log(LOWEST) + 1.0]
    names = [NAMES[active[i]] for i in positions]
    blank = np.zeros((len(names), len(names)))
    likelihood = NoiseLikelihood(
        fitted.problem.nodes, fitted.components, columns, fitted.noise.weights, headings=fitted.problem.headings
    )

    def value(*moves: tuple[int, float]) -> float:
        free = best.copy()
        for i, step in moves:
            free[i] += step
        return likelihood.evaluate(free).log_likelihood

    top = value()
    # a truth noise whose size does not change the likelihood is correlated with no coefficient
    truth = range(len(active), len(best))
    chosen = positions + [i for i in truth if value((i, _STEP)) < top and value((i, -_STEP)) < top]
    curvature = np.zeros((len(chosen), len(chosen)))
    for k, i in enumerate(chosen):
        curvature[k, k] = (2.0 * top - value((i, _STEP)) - value((i, -_STEP))) / _STEP**2
    for (k, i), (m, j) in combinations(enumerate(chosen), 2):
        saddle = [value((i, a * _STEP), (j, b * _STEP)) for a in (1.0, -1.0) for b in (1.0, -1.0)]
        curvature[k, m] = curvature[m, k] = -(saddle[0] - saddle[1] - saddle[2] + saddle[3]) / (4.0 * _STEP**2)
    if not (np.isfinite(curvature).all() and np.linalg.eigvalsh(curvature).min(initial=np.inf) > 0.0):
        return names, blank
    covariance: Array = np.linalg.inv(curvature).astype(np.float64)
    return names, covariance[: len(names), : len(names)]

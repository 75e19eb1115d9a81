"""Fit of the noise: coefficients and the truth's own noise by maximum likelihood, outliers down-weighted.

Beside random coefficients, what these explain must not be counted again as noise of every step: the process is drawn
from its posterior and taken out, and the noise of the rest is fitted, a few times over. A draw, unlike the posterior's
mean, leaves exactly the noise that is there: stochastic EM (Celeux & Diebolt 1985, Computational Statistics Quarterly
2, section 2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.stats import chi2

from odomcorrupt.study.estimate.noise_likelihood import NoiseFit, NoiseLikelihood
from odomcorrupt.study.estimate.random_process import joined, root_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.estimate.random_process import Root
    from odomcorrupt.study.estimate.variance_components import VarianceComponents

__all__ = ["CHANCE", "OUTLIER", "NoiseStart", "fit_noise", "fit_noise_beside", "without_process"]

_ROBUST_ROUNDS = 5
CHANCE, _SIGNAL = 0.002, 0.05
"""Parts of the nodes: as many suspects as chance makes, and so many that they are no outliers."""
OUTLIER = float(chi2.isf(2e-4, 3))
"""A node whose squared innovations sum to more is a suspect: one in 5000 is by chance, so trimming biases nothing."""
_MOST_ROUNDS = 8
_SETTLED = 0.03
"""Change of a logarithm at which the rounds end; draws alone move it by about as much."""
_FAINT = 1e-4
"""Noise smaller than this hardly matters, and its logarithm may be anything."""
_SEED = 20261121


@dataclass(frozen=True, slots=True)
class NoiseStart:
    """Where a fit of the noise starts, and how critically it looks at outliers.

    free : (m,) from an earlier fit, see `NoiseFit.free`; default an initial guess
    weights : (K,) robust weights to keep, so that likelihoods can be compared; default estimated
    elsewhere : whether `free` is of a fit with other columns, so that the maximum near it is no better than a guess
    bursts : whether bursts are known of, so that any number of outliers are outliers
    """

    free: Array | None = None
    weights: Array | None = None
    elsewhere: bool = False
    bursts: bool = False


def fit_noise(
    nodes: Intervals, components: VarianceComponents, columns: Array, start: NoiseStart, *, headings: bool = True
) -> NoiseFit:
    """Return coefficients and truth noise of maximum likelihood; columns (K, 3, m) are free linear terms throughout.

    Intervals whose innovations are too large to be chance get a larger covariance of their own, monotonously, and the
    fit is repeated: slips and gross errors of the truth then do not pass for ordinary noise. Where that would be more
    than a few intervals in a hundred they are signal, and the fit is left plain, unless bursts are known of. Without
    headings the truth's heading noise is held flat.
    """
    ones = np.ones(len(nodes))
    weights = start.weights
    likelihood = NoiseLikelihood(nodes, components, columns, ones if weights is None else weights, headings=headings)
    if start.free is None or len(start.free) != len(likelihood.initial_guess()):
        free = likelihood.restart(likelihood.maximise(likelihood.initial_guess()))
    elif weights is not None:
        free = likelihood.maximise(start.free)
    else:
        # what has died while much else was still wrong may live now
        free = likelihood.maximise(likelihood.revived(start.free))
        free = likelihood.restart(free) if start.elsewhere else free
    plain = done = likelihood.evaluate(free)
    if weights is not None:
        return plain
    for _ in range(_ROBUST_ROUNDS):
        square = np.sum(done.innovations.reshape(-1, 3) ** 2, axis=1)
        worse = square > OUTLIER
        if worse.mean() < CHANCE:
            break
        heavier = np.where(worse, done.weights * square / 3.0, done.weights)
        likelihood = NoiseLikelihood(nodes, components, columns, heavier, headings=headings)
        done = likelihood.evaluate(likelihood.maximise(likelihood.revived(done.free)))
    return plain if np.mean(done.weights > 1.0) > _SIGNAL and not start.bursts else done


def fit_noise_beside(
    problem: Problem, components: VarianceComponents, columns: Array, random: Sequence[Effect], start: NoiseStart
) -> NoiseFit:
    """Return the noise fitted to what random coefficients leave, see `fit_noise`."""
    nodes, headings, weights = problem.nodes, problem.headings, start.weights
    if random and start.free is not None:
        even = np.ones(len(nodes)) if weights is None else weights
        noise = NoiseLikelihood(nodes, components, columns, even, headings=headings).evaluate(start.free)
    else:
        noise = fit_noise(nodes, components, columns, start, headings=headings)
    if not random:
        return noise
    root = joined([root_of(effect, problem) for effect in random])
    for normal in _normals(root):
        before = noise.free
        rest = replace(nodes, residual=nodes.residual - _drawn(noise, problem, columns, root, normal))
        again = NoiseStart(before, weights, bursts=start.bursts)
        noise = fit_noise(rest, components, columns, again, headings=headings)
        weights = noise.weights
        plain = before > np.log(_FAINT)
        if np.abs(noise.free - before)[plain].max(initial=0.0) < _SETTLED:
            break
    return noise


def without_process(noise: NoiseFit, problem: Problem, columns: Array, random: Sequence[Effect]) -> Intervals:
    """Return the intervals with a draw of what random coefficients did taken out: the noise of every step is left."""
    if not random:
        return problem.nodes
    root = joined([root_of(effect, problem) for effect in random])
    drawn = _drawn(noise, problem, columns, root, _normals(root)[0])
    return replace(problem.nodes, residual=problem.nodes.residual - drawn)


def _normals(root: Root) -> Array:
    """Return what the rounds draw from, one row each: the same for the same process."""
    return np.random.default_rng(_SEED).standard_normal((_MOST_ROUNDS, root.mixing.shape[1]))


def _drawn(noise: NoiseFit, problem: Problem, columns: Array, root: Root, normal: Array) -> Array:
    """Return (K, 3): a draw from the posterior of what the processes did to the residuals."""
    whiten, mixing = noise.whitener.whiten, root.mixing
    r, design, knots = whiten(problem.nodes.residual), whiten(columns), noise.whitener.knots(root.spread)
    factor = cholesky(np.eye(mixing.shape[1]) + mixing.T @ knots.inner(knots) @ mixing, lower=True)

    def carried(data: Array) -> Array:
        solved: Array = solve_triangular(factor, mixing.T @ knots.products(data), lower=True)
        return solved

    if columns.shape[2]:
        own = carried(design)
        normal_matrix = design.T @ design - own.T @ own
        theta = np.linalg.lstsq(normal_matrix, design.T @ r - own.T @ carried(r[:, None])[:, 0], rcond=None)[0]
        r = r - design @ theta
    factors = solve_triangular(factor, carried(r[:, None])[:, 0] + normal, lower=True, trans="T")
    process: Array = root.spread @ (mixing @ factors)
    return process.reshape(-1, 3)

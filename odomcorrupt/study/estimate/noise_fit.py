"""Maximum-likelihood fit of the noise coefficients and of the truth noise, with outliers down-weighted.

If the model has random coefficients, the variation they explain must not be counted again as noise of each step. The
process is drawn from its posterior and subtracted, and the noise of the rest is fitted, over a few iterations. A draw,
unlike the posterior mean, leaves the right amount of noise: stochastic EM (Celeux & Diebolt 1985, Computational
Statistics Quarterly 2, section 2).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from odomcorrupt.study.estimate.noise_likelihood import NoiseFit, NoiseLikelihood
from odomcorrupt.study.estimate.random_process import joined, knots_of
from odomcorrupt.study.estimate.whitener import KnotPosterior

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.intervals import Intervals
    from odomcorrupt.study.estimate.noise_likelihood import VarianceComponents
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.estimate.random_process import Knots

_ROBUST_ROUNDS = 5
_CHANCE, _SIGNAL = 0.002, 0.05
"""Fraction of outliers, or probability of the largest, that chance explains; fraction above which they are signal."""
_OUTLIER = float(chi2.isf(2e-4, 3))
"""Sum of squared innovations above which a node is an outlier: 1 in 5000 by chance, so trimming adds no bias."""
_MOST_ROUNDS = 8
_SETTLED = 0.03
"""Change of a log coefficient at which the rounds end: about as large as the scatter between draws."""
_FAINT = 1e-4
"""Noise below this is negligible; its logarithm is not tested for convergence."""
_SEED = 20261121


@dataclass(frozen=True, slots=True)
class NoiseStart:
    """Initial values of a noise fit, and its treatment of outliers.

    free : (m,) from an earlier fit, see `NoiseFit.free`; default: an initial guess
    weights : (K,) robust weights to keep, so that likelihoods can be compared; default: estimated
    elsewhere : whether `free` is from a fit with other columns; then the fit is also tried from revived coefficients
    bursts : whether the model has slip bursts; then any number of outliers is accepted
    """

    free: Array | None = None
    weights: Array | None = None
    elsewhere: bool = False
    bursts: bool = False


def outliers(square: Array) -> NDArray[np.bool_]:
    """Return a mask (K,) of the intervals that are outliers; none if chance explains their number and size.

    square : (K,) sums of three squared innovations. The largest of K normal triples exceeds its limit in one fit of
        500, so a single jump of the truth is an outlier in a recording of any length
    """
    odd: NDArray[np.bool_] = square > _OUTLIER
    by_chance = odd.mean() < _CHANCE and not (square > chi2.isf(_CHANCE / len(square), 3)).any()
    return np.zeros_like(odd) if by_chance else odd


def fit_noise(
    intervals: Intervals, components: VarianceComponents, columns: Array, start: NoiseStart, *, headings: bool = True
) -> NoiseFit:
    """Return maximum-likelihood coefficients and truth noise; columns (K, 3, m) are free linear terms throughout.

    Intervals with innovations too large for chance get a larger covariance, which never shrinks again, and the fit is
    repeated: slips and gross errors of the truth are then not fitted as noise. If more than a few per cent of the
    intervals are outliers they are signal, and the fit without weights is returned, unless `start.bursts` is set.
    If the truth has no headings, its heading noise is held at a large constant.
    """
    ones = np.ones(len(intervals))
    weights = start.weights
    likelihood = NoiseLikelihood(
        intervals, components, columns, ones if weights is None else weights, headings=headings
    )
    if start.free is None or len(start.free) != len(likelihood.initial_guess()):
        plain = likelihood.restart(likelihood.maximise(likelihood.initial_guess()))
    elif weights is not None:
        plain = likelihood.maximise(start.free)
    else:
        # a coefficient that fell to zero while effects were still wrong may be non-zero now
        plain = likelihood.maximise(likelihood.revived(start.free))
        plain = likelihood.restart(plain) if start.elsewhere else plain
    if weights is not None:
        return plain
    done = plain
    for _ in range(_ROBUST_ROUNDS):
        square = np.sum(done.innovations.reshape(-1, 3) ** 2, axis=1)
        worse = outliers(square)
        if not worse.any():
            break
        heavier = np.where(worse, done.weights * square / 3.0, done.weights)
        likelihood = NoiseLikelihood(intervals, components, columns, heavier, headings=headings)
        done = likelihood.maximise(likelihood.revived(done.free))
    return plain if np.mean(done.weights > 1.0) > _SIGNAL and not start.bursts else done


def fit_noise_beside(
    problem: Problem, components: VarianceComponents, columns: Array, random: Sequence[Effect], start: NoiseStart
) -> NoiseFit:
    """Return the noise fitted to the residuals without the random coefficients' part, see `fit_noise`.

    columns : (K, 3, m) regressors of the linear parameters
    random : random effects in the model; none: the same as `fit_noise`
    start : noise parameters and robust weights to start from
    """
    intervals, headings, weights = problem.intervals, problem.headings, start.weights
    if random and start.free is not None:
        even = np.ones(len(intervals)) if weights is None else weights
        noise = NoiseLikelihood(intervals, components, columns, even, headings=headings).evaluate(start.free)
    else:
        noise = fit_noise(intervals, components, columns, start, headings=headings)
    if not random:
        return noise
    knots = joined([knots_of(effect, problem) for effect in random])
    for normal in _normals(knots):
        before = noise.free
        rest = replace(intervals, residual=intervals.residual - _drawn(noise, problem, columns, knots, normal))
        refit_start = NoiseStart(before, weights, bursts=start.bursts)
        noise = fit_noise(rest, components, columns, refit_start, headings=headings)
        weights = noise.weights
        plain = before > np.log(_FAINT)
        if np.abs(noise.free - before)[plain].max(initial=0.0) < _SETTLED:
            break
    return noise


def without_process(noise: NoiseFit, problem: Problem, columns: Array, random: Sequence[Effect]) -> Intervals:
    """Return the intervals with a posterior draw of the random coefficients subtracted; the step noise is left."""
    if not random:
        return problem.intervals
    knots = joined([knots_of(effect, problem) for effect in random])
    drawn = _drawn(noise, problem, columns, knots, _normals(knots)[0])
    return replace(problem.intervals, residual=problem.intervals.residual - drawn)


def _normals(knots: Knots) -> Array:
    """Return standard normal draws, one row per round; always the same for the same process."""
    return np.random.default_rng(_SEED).standard_normal((_MOST_ROUNDS, len(knots.time_s)))


def _drawn(noise: NoiseFit, problem: Problem, columns: Array, knots: Knots, normal: Array) -> Array:
    """Return a posterior draw (K, 3) of the processes' contribution to the residuals."""
    whiten = noise.whitener.whiten
    r, design = whiten(problem.intervals.residual)[:, None], whiten(columns)
    posterior = KnotPosterior.of(noise.whitener.knots(knots.spread), knots.precision)
    if columns.shape[2]:
        own = posterior.scores(design)
        normal_matrix = design.T @ design - own.T @ own
        theta = np.linalg.lstsq(normal_matrix, design.T @ r - own.T @ posterior.scores(r), rcond=None)[0]
        r = r - design @ theta
    process: Array = knots.spread @ posterior.values(posterior.scores(r) + normal[:, None])
    return process.reshape(-1, 3)

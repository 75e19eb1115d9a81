"""White noise beside gains that wander: what a process carries must not be counted again as noise of every step.

The process is drawn from its posterior and taken out, and the noise of what is left is fitted; a few times over. A
draw, unlike the posterior's mean, leaves exactly the noise that is there: stochastic EM (Celeux & Diebolt 1985,
Computational Statistics Quarterly 2, section 2).
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cholesky, solve_triangular

from odomcorrupt.study.estimate.noise_fit import fit_noise
from odomcorrupt.study.estimate.noise_likelihood import NoiseTask
from odomcorrupt.study.estimate.random_process import root_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.noise_likelihood import NoiseFit
    from odomcorrupt.study.estimate.problem import Problem
    from odomcorrupt.study.estimate.variance_components import LawPieces

__all__ = ["noise_beside"]

_MOST_ROUNDS = 8
_SETTLED = 0.03
"""Change of a logarithm at which the rounds end; draws alone move it by about as much."""
_FAINT = 1e-4
"""Noise smaller than this hardly matters, and its logarithm goes anywhere."""
_SEED = 20261121


def noise_beside(
    problem: Problem,
    pieces: LawPieces,
    columns: Array,
    random: Sequence[Effect],
    *,
    start: Array | None,
    weights: Array | None,
    elsewhere: bool,
    bursts: bool,
) -> NoiseFit:
    """Return the noise fitted to what wandering gains leave, see `fit_noise`; columns (K, 3, m) are free throughout."""
    nodes, headings = problem.nodes, problem.headings
    if random and start is not None:
        even = np.ones(len(nodes)) if weights is None else weights
        noise = NoiseTask(nodes, pieces, columns, even, headings=headings).evaluate(start)
    else:
        noise = fit_noise(
            nodes,
            pieces,
            columns,
            start=start,
            weights=weights,
            headings=headings,
            elsewhere=elsewhere,
            bursts=bursts,
        )
    if not random:
        return noise
    roots = np.concatenate([root_of(effect, problem) for effect in random], axis=2)
    for normal in np.random.default_rng(_SEED).standard_normal((_MOST_ROUNDS, roots.shape[2])):
        before = noise.free
        left = nodes.residual - _drawn(noise, problem, columns, roots, normal)
        noise = fit_noise(
            replace(nodes, residual=left),
            pieces,
            columns,
            start=before,
            weights=weights,
            headings=headings,
            bursts=bursts,
        )
        weights = noise.weights
        plain = before > np.log(_FAINT)
        if np.abs(noise.free - before)[plain].max(initial=0.0) < _SETTLED:
            break
    return noise


def _drawn(noise: NoiseFit, problem: Problem, columns: Array, roots: Array, normal: Array) -> Array:
    """Return (K, 3) what the processes did to the residuals: a draw of what they may have been."""
    whiten = noise.whitener.whiten
    r, believed, white = whiten(problem.nodes.residual), whiten(columns), whiten(roots)
    factor = cholesky(np.eye(white.shape[1]) + white.T @ white, lower=True)

    def carried(data: Array) -> Array:
        solved: Array = solve_triangular(factor, white.T @ data, lower=True)
        return solved

    if columns.shape[2]:
        own = carried(believed)
        normal_matrix = believed.T @ believed - own.T @ own
        theta = np.linalg.lstsq(normal_matrix, believed.T @ r - own.T @ carried(r), rcond=None)[0]
        r = r - believed @ theta
    process: Array = roots @ solve_triangular(factor, carried(r) + normal, lower=True, trans="T")
    return process

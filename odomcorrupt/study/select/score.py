"""Score tests: which effect would explain what is left, each tried at its identity on the fitted model.

One whitened column per parameter; an effect of two parameters is tested as a group. Two gates guard against false
names: the plain chi-square, Bonferroni-corrected over the library (right when the noise model is right), and a
moderated cluster-robust F (right when it is not: the sum over blocks of the run shows how much a score really varies).
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as fisher_f

from odomcorrupt.study.estimate.cluster_variance import PRIOR_DOF, between_blocks, block_of, inflation, shared_variance

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit

__all__ = ["ColumnScore", "Score", "left_over", "score_columns", "score_tests"]

_SEPARABLE = 0.02
"""A column that loses all but this part of its length to what is believed already cannot be told from it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnScore:
    """What the residual says about a group of columns.

    estimate, standard_error : (p,) of their factors, to first order, errors made robust
    statistic : chi-square with p degrees under the fitted model
    inflation : by how much the score varies more between blocks than the model says, at least 1
    p : probability of such a score anywhere in the family without any effect, by the worse of both gates
    separable : whether the group can be told from what is believed already at all
    held_out_nats, held_out_error : gain in log likelihood on blocks left out of the estimate, and its standard error
    """

    estimate: Array
    standard_error: Array
    statistic: float
    inflation: float
    p: float
    separable: bool
    held_out_nats: float
    held_out_error: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Score(ColumnScore):
    """What the residual says about one effect; the factors are its parameters."""

    effect: Effect


@dataclass(frozen=True, slots=True)
class Left:
    """What the believed columns leave of whitened data.

    basis : (3 K, q) orthonormal, spanning the believed columns
    residual : (3 K,) what is left of the fit's innovations
    """

    basis: Array
    residual: Array

    def of(self, white: Array) -> Array:
        """Return what is left of whitened columns (3 K, c)."""
        rest: Array = white - self.basis @ (self.basis.T @ white)
        return rest


def left_over(fit: Fit, believed: Array) -> Left:
    """Return what the believed columns (K, 3, q) leave."""
    r = fit.noise.innovations
    white = fit.noise.whitener.whiten(believed) if believed.shape[2] else np.zeros((len(r), 0))
    basis = np.linalg.qr(white)[0] if white.shape[1] else white
    return Left(basis, r - basis @ (basis.T @ r))


def score_tests(fit: Fit, candidates: Sequence[Effect], believed: Array) -> list[Score]:
    """Test every candidate effect at its present values (usually the identity) on a fitted model.

    Parameters
    ----------
    fit : the fitted model
    candidates : the family of effects
    believed : (K, 3, q)
        Columns of what is believed already; candidates are tested beside them.

    """
    scores = score_columns(fit, [fit.problem.columns(effect) for effect in candidates], believed)
    return [Score(effect=effect, **asdict(score)) for effect, score in zip(candidates, scores, strict=True)]


def score_columns(fit: Fit, groups: Sequence[Array], believed: Array) -> list[ColumnScore]:
    """Test a family of groups of columns (K, 3, p), each beside what is believed (K, 3, q)."""
    left = left_over(fit, believed)
    block = np.repeat(block_of(fit.problem), 3)
    tests = []
    for group in groups:
        raw = fit.noise.whitener.whiten(group)
        tests.append(_test(left.residual, left.of(raw), raw, block))
    usable = [t for t in tests if t.separable]
    shared = shared_variance(np.array([t.variance for t in usable]), np.array([t.dof for t in usable]))
    return [_judged(t, shared, len(usable)) for t in tests]


@dataclass(frozen=True, slots=True)
class _Test:
    estimate: Array
    covariance: Array
    statistic: float
    variance: float
    dof: float
    separable: bool
    held_out: Array


def _test(r: Array, column: Array, raw: Array, block: NDArray[np.int64]) -> _Test:
    count = column.shape[1]
    normal = column.T @ column
    own = np.einsum("ij,ij->j", raw, raw)
    kept = np.diag(normal) > _SEPARABLE**2 * np.maximum(own, 1e-300)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    condition = np.linalg.cond(normal / np.outer(scale, scale)) if kept.all() else np.inf
    if condition > 1e8:
        nothing = np.full(count, np.nan)
        return _Test(nothing, np.zeros((count, count)), 0.0, 1.0, 1.0, separable=False, held_out=np.zeros(2))
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    estimate = covariance @ (column.T @ r)
    best = column @ estimate
    statistic = float(best @ r)
    blocks = int(block.max()) + 1
    length = np.sqrt(max(float(best @ best), 1e-300))
    unit = best / length
    ((variance,), (dof,)) = between_blocks(block, unit[:, None], r)
    held_out = _held_out(r, column, block, blocks)
    return _Test(estimate, covariance, statistic, float(variance), float(dof), separable=True, held_out=held_out)


def _held_out(r: Array, column: Array, block: NDArray[np.int64], blocks: int) -> Array:
    """Return the gain (nats) of each block when the estimate comes from all the others."""
    by_block = np.array([(column[block == b].T @ column[block == b]).ravel() for b in range(blocks)])
    score = np.array([column[block == b].T @ r[block == b] for b in range(blocks)])
    count = column.shape[1]
    normal = by_block.reshape(blocks, count, count)
    gains = np.zeros(blocks)
    for b in range(blocks):
        rest = normal.sum(axis=0) - normal[b]
        theta = np.linalg.lstsq(rest, score.sum(axis=0) - score[b], rcond=None)[0]
        gains[b] = theta @ score[b] - 0.5 * theta @ normal[b] @ theta
    return gains


def _judged(test: _Test, shared: float, family: int) -> ColumnScore:
    count = len(test.estimate)
    inflated = float(inflation(np.array(test.variance), np.array(test.dof), shared))
    if test.separable:
        plain = chi2.sf(test.statistic, count)
        robust = fisher_f.sf(test.statistic / (count * inflated), count, PRIOR_DOF + test.dof)
        p = min(1.0, family * float(max(plain, robust)))
    else:
        p = 1.0
    gains = test.held_out
    return ColumnScore(
        estimate=test.estimate,
        standard_error=np.sqrt(np.diag(test.covariance) * inflated),
        statistic=test.statistic,
        inflation=inflated,
        p=p,
        separable=test.separable,
        held_out_nats=float(gains.sum()),
        held_out_error=float(np.std(gains, ddof=1) * np.sqrt(len(gains))),
    )

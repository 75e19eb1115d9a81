"""Score tests of terms on the residual of a fit, each at its working point, to first order.

Each coefficient has one whitened column; a term with two is tested as a group. Two tests guard against false
inclusions. A chi-square test, Bonferroni-corrected over the family, is valid if the noise model is right. A moderated
cluster-robust F test is valid without it: sums over blocks of the run show the actual variance of a score.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2
from scipy.stats import f as fisher_f

from odomcorrupt.study.estimate.gauss_newton import orthonormal
from odomcorrupt.study.estimate.robust_errors import (
    PRIOR_DOF,
    between_blocks,
    block_of,
    block_sums,
    inflation,
    shared_variance,
)
from odomcorrupt.study.select.decisions import penalty

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.terms.term import Term

_SEPARABLE = 0.02
"""Fraction of a column's length outside the span of the design matrix below which it is not separable from it."""
_OTHERS, _STRONG = 50, 1e-6
"""Number of other columns whose variance is measured beside a strong group, and probability that makes it strong."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ColumnScore:
    """Score test of a group of p columns.

    estimate, standard_error : (p,) coefficients to first order; their errors are cluster-robust
    statistic : chi-square with p degrees of freedom under the fitted model
    inflation : variance of the score between blocks relative to that of the noise model, at least 1
    p : probability of such a score anywhere in the family without any effect, the larger one of both tests
    separable : whether the group is separable from the model at all
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

    def significant(self, level: float) -> bool:
        """Return whether the group is separable from the model, passes both tests and gains on held-out blocks."""
        return self.separable and self.p < level and self.held_out_nats > self.held_out_error


@dataclass(frozen=True, slots=True, kw_only=True)
class Score(ColumnScore):
    """Score test of a term, with one column per coefficient.

    penalty : gain at which the term breaks even, nats, see `decisions.penalty`
    """

    term: Term
    penalty: float

    @property
    def effect(self) -> Effect:
        """The tested effect: at its working point, with amplitudes at their identity."""
        return self.term.start

    @property
    def estimated(self) -> Effect:
        """The effect at its estimated coefficients, kept within their bounds."""
        return self.term.effect(self.estimate.tolist())

    @property
    def nats(self) -> float:
        """Gain in log likelihood under the noise model, minus the penalty."""
        return 0.5 * self.statistic - self.penalty

    @property
    def robust_nats(self) -> float:
        """The same with the gain divided by the inflation."""
        return 0.5 * self.statistic / self.inflation - self.penalty


@dataclass(frozen=True, slots=True)
class Projection:
    """The part of whitened data that the design matrix of a fit does not span.

    basis : (3 K, q) orthonormal, spanning the whitened design matrix
    residual : (3 K,) innovations of the fit without their part in that span
    """

    basis: Array
    residual: Array

    def of(self, white: Array) -> Array:
        """Return whitened columns (3 K, c) without their part in the span."""
        return white - self.basis @ (self.basis.T @ white)

    def gain(self, white: Array) -> float:
        """Return the joint gain of whitened columns (3 K, p), nats, to first order."""
        rest = self.of(white)
        if not rest.any():
            return 0.0
        if rest.shape[1] == 1:
            (own,) = rest.T
            return 0.5 * float(own @ self.residual) ** 2 / float(own @ own)
        return 0.5 * float((rest @ np.linalg.lstsq(rest, self.residual, rcond=None)[0]) @ self.residual)


def project_out(fit: Fit, *more: Array) -> Projection:
    """Return the projection off the span of a fit's design matrix and, if given, of more columns (K, 3, c)."""
    r, basis = fit.noise.innovations, fit.span
    if more:
        basis = orthonormal(fit.noise.whitener.whiten(np.concatenate((fit.design_matrix, *more), axis=2)))
    return Projection(basis, r - basis @ (basis.T @ r))


def score_terms(
    fit: Fit,
    terms: Sequence[Term],
    decisions: Decisions,
    *,
    family: int | None = None,
    columns: Sequence[Array] | None = None,
) -> list[Score]:
    """Return the score tests of terms, each beside the model of a fit.

    Parameters
    ----------
    fit, terms, decisions : the model, the tested terms, and the thresholds that define penalties
    family : number of kinds of terms for the Bonferroni correction, beside the trials of each; default: those tested
    columns : (K, 3, p) columns of each term, if already computed
    """
    count = len(fit.problem.intervals)
    groups = [term.columns(fit.problem) for term in terms] if columns is None else columns
    scores = score_columns(fit, groups, family=family)
    return [
        Score(
            **asdict(replace(score, p=min(1.0, score.p * term.trials))),
            term=term,
            penalty=penalty(term, count, decisions),
        )
        for term, score in zip(terms, scores, strict=True)
    ]


def score_columns(fit: Fit, groups: Sequence[Array], *, family: int | None = None) -> list[ColumnScore]:
    """Return the score tests of groups of columns (K, 3, p), each beside the model of a fit.

    family : as in `score_terms`
    """
    rest = project_out(fit)
    block = np.repeat(block_of(fit.problem), 3)
    tests = []
    for group in groups:
        raw = fit.noise.whitener.whiten(group)
        tests.append(_test(rest.residual, rest.of(raw), raw, block))
    usable = [t for t in tests if t.separable]
    shared = shared_variance(np.array([t.variance for t in usable]), np.array([t.dof for t in usable]))
    chosen = [t.unit for t in usable[:: max(1, len(usable) // _OTHERS)]]
    others = np.stack(chosen, axis=1) if chosen else np.zeros((len(block), 0))
    count = len(usable) if family is None else family
    return [_tested(t, _shared_beside(t, others, rest.residual, block, shared, count), count) for t in tests]


def _shared_beside(test: _Test, others: Array, r: Array, block: NDArray[np.int64], shared: float, family: int) -> float:
    """Return the shared variance ratio, with the tested group in the model if its test is strong.

    A strong missing term makes the scores of all other columns vary between blocks. This variation is no evidence
    against the term.

    others : (3 K, o) best directions of other groups
    """
    if shared <= 1.0 or not test.separable or family * chi2.sf(test.statistic, len(test.estimate)) > _STRONG:
        return shared
    explained = r - test.unit * (test.unit @ r)
    return min(shared, shared_variance(*between_blocks(block, others, explained)))


@dataclass(frozen=True, slots=True)
class _Test:
    """Test of one group; `unit` (3 K,) is the direction of its best combination of columns."""

    estimate: Array
    covariance: Array
    statistic: float
    variance: float
    dof: float
    separable: bool
    held_out: Array
    unit: Array


def _test(r: Array, column: Array, raw: Array, block: NDArray[np.int64]) -> _Test:
    count = column.shape[1]
    normal = column.T @ column
    own = np.einsum("ij,ij->j", raw, raw)
    kept = np.diag(normal) > _SEPARABLE**2 * np.maximum(own, 1e-300)
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    condition = np.linalg.cond(normal / np.outer(scale, scale)) if kept.all() else np.inf
    if condition > 1e8:
        nothing = np.full(count, np.nan)
        return _Test(nothing, np.zeros((count, count)), 0.0, 1.0, 1.0, separable=False, held_out=np.zeros(2), unit=r)
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    estimate = covariance @ (column.T @ r)
    best = column @ estimate
    statistic = float(best @ r)
    length = np.sqrt(max(float(best @ best), 1e-300))
    unit = best / length
    ((variance,), (dof,)) = between_blocks(block, unit[:, None], r)
    held_out = _held_out(r, column, block)
    return _Test(
        estimate, covariance, statistic, float(variance), float(dof), separable=True, held_out=held_out, unit=unit
    )


def _held_out(r: Array, column: Array, block: NDArray[np.int64]) -> Array:
    """Return the gain of each block, nats, with the estimate from all other blocks."""
    count = column.shape[1]
    squares = (column[:, :, None] * column[:, None, :]).reshape(-1, count * count)
    normal = block_sums(block, squares).reshape(-1, count, count)
    score = block_sums(block, column * r[:, None])
    rest = np.linalg.pinv(normal.sum(axis=0) - normal, rcond=count * np.finfo(np.float64).eps, hermitian=True)
    theta = np.einsum("bij,bj->bi", rest, score.sum(axis=0) - score)
    return np.einsum("bi,bi->b", theta, score) - 0.5 * np.einsum("bi,bij,bj->b", theta, normal, theta)


def _tested(test: _Test, shared: float, family: int) -> ColumnScore:
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

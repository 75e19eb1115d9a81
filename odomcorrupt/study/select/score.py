"""Score tests of terms beside a fit, to first order, and the projection off what the fit already explains.

Estimates, errors and gains come from the sums over folds of `evidence`. Errors are those between folds where these are
larger than the noise model predicts.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from odomcorrupt.study.estimate.gauss_newton import orthonormal
from odomcorrupt.study.estimate.robust_errors import inflation, shared_variance
from odomcorrupt.study.select.evidence import FOLDS, SEPARABLE

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.evidence import Evidence
    from odomcorrupt.study.terms.term import BasisTerm, LibraryTerm, Term


@dataclass(frozen=True, slots=True, kw_only=True)
class Score:
    """Score test of a term with p coefficients.

    estimate, standard_error : (p,) coefficients to first order, and their errors; NaN if they are not separable
    inflation : variance of the estimate between folds relative to that of the noise model, at least 1
    p : probability of such a score anywhere in the family without any effect
    separable : whether the term is separable from the model at all
    held_out_nats, held_out_error : gain in log likelihood on left-out folds, and its standard error
    cost : gain at which the term breaks even, nats
    """

    term: Term
    estimate: Array
    standard_error: Array
    inflation: float
    p: float
    separable: bool
    held_out_nats: float
    held_out_error: float
    cost: float

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
        """Gain on left-out folds minus the cost."""
        return self.held_out_nats - self.cost


def scores_of(evidence: Evidence, terms: Sequence[LibraryTerm | BasisTerm]) -> list[Score]:
    """Return the score test of each term alone, beside the model that is projected out of the evidence.

    terms : those of the evidence, in its order
    """
    gram, score = evidence.gram.sum(axis=0), evidence.score.sum(axis=0)
    folds = evidence.gains([(i,) for i in range(len(terms))]).folds
    parts = []
    for i in range(len(terms)):
        own = evidence.columns((i,))
        normal = gram[np.ix_(own, own)]
        scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        covariance = np.linalg.pinv(normal / np.outer(scale, scale), hermitian=True) / np.outer(scale, scale)
        left = 1.0 / np.maximum(np.diag(covariance), 1e-300)
        theta = covariance @ score[own]
        statistic = float(theta @ score[own])
        moved = (evidence.score[:, own] - evidence.gram[:, own[:, None], own] @ theta) @ theta
        ratio = FOLDS / (FOLDS - 1) * float(moved @ moved) / max(statistic, 1e-300)
        separable = bool(np.all(left > SEPARABLE * np.maximum(evidence.whole[own], 1e-300)))
        parts.append((theta, covariance, statistic, ratio, separable))
    ratios = np.array([ratio for *_, ratio, separable in parts if separable])
    shared, names = shared_variance(ratios, np.full(len(ratios), FOLDS - 1.0)), len({term.name for term in terms})
    found = []
    for i, (theta, covariance, statistic, ratio, separable) in enumerate(parts):
        inflated = float(inflation(np.array(ratio), np.array(FOLDS - 1.0), shared))
        p = names * terms[i].trials * chi2.sf(statistic / inflated, len(theta))
        found.append(
            Score(
                term=terms[i],
                estimate=theta if separable else np.full(len(theta), np.nan),
                standard_error=np.sqrt(np.diag(covariance) * inflated) if separable else np.full(len(theta), np.nan),
                inflation=inflated,
                p=min(1.0, float(p)) if separable else 1.0,
                separable=separable,
                held_out_nats=float(folds[i].sum()),
                held_out_error=float(np.std(folds[i], ddof=1) * np.sqrt(FOLDS)),
                cost=float(evidence.cost[i]),
            )
        )
    return found


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

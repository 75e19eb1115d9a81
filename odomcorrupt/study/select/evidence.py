"""Held-out evidence of sets of terms, by small linear algebra on sums of matrices over folds.

All candidate columns are whitened once. Each fold of the data keeps its Gram matrix and its products with the
residual, so that the gain of any set of terms on left-out folds needs no pass over the data: with the sums A and b of
the other folds and a Gaussian prior of precision P on the coefficients, theta = (A + P)^-1 b, and the left-out fold
gains theta' b_k - theta' G_k theta / 2. The evidence of a set is the sum over folds minus the cost of its terms.

Score tests of single terms beside a fit, to first order, come from the same sums. Their errors are those between folds
where these are larger than the noise model predicts.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp
from typing import TYPE_CHECKING

import numpy as np
from scipy.stats import chi2

from odomcorrupt.study.estimate.gauss_newton import orthonormal
from odomcorrupt.study.estimate.noise_likelihood import pseudo_inverse
from odomcorrupt.study.estimate.robust_errors import inflation, shared_variance

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.terms.term import BasisTerm, LibraryTerm, Term

FOLDS = 10
"""Number of folds: each holds every tenth block of a recording, or every tenth recording."""
_BEAM, _NEXT, _WITHIN = 6, 30, 12.0
"""Sets extended in a step, extensions evaluated of each, and nats below the best at which sets are not extended."""
_STEPS = 3
"""Largest number of terms that a search adds."""
SEPARABLE = 4e-4
"""Fraction of a column's squared length that has to remain beside the other terms of a set."""

Subset = tuple[int, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Gains:
    """Evidence of sets of terms.

    score : (M,) held-out gain minus the cost of the terms, nats; minus infinity if a coefficient is out of bounds
    folds : (M, F) held-out gain of each fold, nats
    """

    score: Array
    folds: Array


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Evidence:
    """Sums of matrices of J terms with P columns over F folds.

    first : (J + 1,) index of each term's first column, and P
    gram, score : (F, P, P) and (F, P): products of whitened columns with each other and with the residual
    whole : (P,) squared lengths of the columns before what the model has in any case was projected out
    precision : (P,) prior precision of each coefficient
    low, high : (P,) bounds of the coefficients
    cost : (J,) nats that a term has to gain
    group : (J,) terms with the same number exclude each other: shapes of one effect
    limited, most : (J,) whether a term is one of a kind of which a set may have only `most`
    """

    first: NDArray[np.int64]
    gram: Array
    score: Array
    precision: Array
    low: Array
    high: Array
    cost: Array
    group: NDArray[np.int64]
    limited: NDArray[np.bool_]
    most: int = 2
    whole: Array

    def columns(self, subset: Iterable[int]) -> NDArray[np.int64]:
        """Return the column indices (p,) of a set of terms."""
        parts = [np.arange(self.first[i], self.first[i + 1]) for i in subset]
        return np.concatenate(parts) if parts else np.zeros(0, dtype=np.int64)

    def estimate(self, subset: Subset) -> Array:
        """Return the coefficients (p,) of a set of terms from all folds."""
        own = self.columns(subset)
        normal = self.gram.sum(axis=0)[np.ix_(own, own)] + np.diag(self.precision[own])
        return np.linalg.solve(normal, self.score.sum(axis=0)[own])

    def gains(self, subsets: Sequence[Subset]) -> Gains:
        """Return the evidence of sets of terms."""
        score, folds = np.full(len(subsets), -np.inf), np.zeros((len(subsets), len(self.gram)))
        columns = [self.columns(subset) for subset in subsets]
        for width in {len(own) for own in columns}:
            which = [m for m, own in enumerate(columns) if len(own) == width]
            own = np.array([columns[m] for m in which], dtype=np.int64).reshape(len(which), width)
            folds[which], unlikely = self._of(own)
            paid = [self.cost[list(subsets[m])].sum() for m in which]
            score[which] = folds[which].sum(axis=1) - paid - unlikely
        return Gains(score, folds)

    def _of(self, own: NDArray[np.int64]) -> tuple[Array, Array]:
        """Return the gains (M, F) of sets of columns (M, p) on left-out folds, and minus their log prior (M,), nats."""
        if not own.shape[1]:
            return np.zeros((len(own), len(self.gram))), np.zeros(len(own))
        gram = self.gram[:, own[:, :, None], own[:, None, :]].swapaxes(0, 1)  # (M, F, p, p)
        score = self.score[:, own].swapaxes(0, 1)  # (M, F, p)
        prior = self.precision[own][:, :, None] * np.eye(own.shape[1])
        whole = gram.sum(axis=1)
        others = whole[:, None] - gram + prior[:, None]
        theta = np.linalg.solve(others, (score.sum(axis=1)[:, None] - score)[..., None])[..., 0]
        gains = np.einsum("mfi,mfi->mf", theta, score) - 0.5 * np.einsum("mfi,mfij,mfj->mf", theta, gram, theta)
        inverse = np.linalg.inv(whole + prior)
        best = np.einsum("mij,mj->mi", inverse, score.sum(axis=1))
        inside = ((best >= self.low[own]) & (best <= self.high[own])).all(axis=1)
        # what remains of a column beside the others, 1 / (A^-1)_ii, against its own length
        alone = np.einsum("mii->mi", whole)
        separable = (1.0 / np.einsum("mii->mi", inverse) - self.precision[own] > SEPARABLE * alone).all(axis=1)
        unlikely = 0.5 * np.einsum("mp,mp->m", best**2, self.precision[own])
        return gains, np.where(inside & separable, unlikely, np.inf)

    def extensions(self, subset: Subset) -> list[Subset]:
        """Return a set with one more term each, the most promising first by the gain on all data."""
        own, total, score = self.columns(subset), self.gram.sum(axis=0), self.score.sum(axis=0)
        left, length = score, np.diag(total).copy()
        if len(own):
            normal = total[np.ix_(own, own)] + np.diag(self.precision[own])
            solved = np.linalg.solve(normal, np.column_stack((score[own], total[own])))
            left = score - total[:, own] @ solved[:, 0]
            length = length - np.einsum("ji,ij->j", total[:, own], solved[:, 1:])
        single = np.where(
            length > SEPARABLE * np.diag(total), left**2 / np.maximum(length + self.precision, 1e-300), 0.0
        )
        gain = 0.5 * np.add.reduceat(single, self.first[:-1]) - self.cost
        taken = {int(self.group[i]) for i in subset}
        full = self.limited[list(subset)].sum() >= self.most
        order = [j for j in np.argsort(-gain) if self.group[j] not in taken and not (full and self.limited[j])]
        best: dict[int, int] = {}
        kept = []
        for j in order:
            # two shapes of one effect are enough: others are their neighbours
            if best.get(int(self.group[j]), 0) < 2:
                best[int(self.group[j])] = best.get(int(self.group[j]), 0) + 1
                kept.append(tuple(sorted((*subset, int(j)))))
            if len(kept) == _NEXT:
                break
        return kept


@dataclass(slots=True)
class Search:
    """Search for the set of terms with the largest evidence: forward steps of a beam, then backward and swap steps.

    Columns are linear: many terms at once may be too far for them, so that rounds take few.

    start : the set that the columns are linearised at
    seen : evidence of every set that was evaluated, nats
    """

    evidence: Evidence
    start: Subset
    seen: dict[Subset, float]

    @classmethod
    def of(cls, evidence: Evidence, start: Subset = ()) -> Search:
        """Return the search that began with the empty set and with `start`."""
        search = cls(evidence, start, {(): 0.0})
        search._evaluate([start])
        front: list[Subset] = list(dict.fromkeys(((), start)))
        for _ in range(_STEPS):
            new = search._evaluate([longer for subset in front for longer in evidence.extensions(subset)])
            least = max(search.seen.values()) - _WITHIN
            front = [s for s in sorted(new, key=lambda s: -search.seen[s])[:_BEAM] if search.seen[s] > least]
            if not front:
                break
        while search._moved():
            pass
        return search

    @property
    def best(self) -> Subset:
        """The set with the largest evidence."""
        return max(self.seen, key=lambda s: (self.seen[s], -len(s)))

    def odds_against(self, term: int) -> float:
        """Return the odds of the evaluated sets without a term, in any of its shapes, against those with it."""
        shapes = set(np.flatnonzero(self.evidence.group == self.evidence.group[term]).tolist())
        most = max(self.seen.values())
        weights = [(exp(score - most), not shapes.isdisjoint(subset)) for subset, score in self.seen.items()]
        with_it = sum(weight for weight, has in weights if has)
        return sum(weight for weight, has in weights if not has) / max(with_it, 1e-300)

    def refuse(self, subset: Subset) -> None:
        """Exclude a set, all others of the same effects, and those with more than half as many terms that are new."""
        group = self.evidence.group
        refused, most = sorted(group[list(subset)]), max(len(set(subset) - set(self.start)) // 2, 1)
        for other in self.seen:
            if sorted(group[list(other)]) == refused or len(set(other) - set(self.start)) > most:
                self.seen[other] = -np.inf

    def _evaluate(self, subsets: Iterable[Subset]) -> list[Subset]:
        """Evaluate sets that were not seen yet; return them."""
        if new := [s for s in dict.fromkeys(subsets) if s not in self.seen]:
            self.seen.update(zip(new, self.evidence.gains(new).score.tolist(), strict=True))
        return new

    def _moved(self) -> bool:
        """Try to drop and to replace each term of the best set; return whether a better set was found."""
        best = self.best
        without = [tuple(j for j in best if j != i) for i in best]
        self._evaluate([*without, *(s for subset in without for s in self.evidence.extensions(subset))])
        if len(set(best) - set(self.start)) < _STEPS:
            self._evaluate(self.evidence.extensions(best))
        return self.best != best

    def clear_parts(self, errors: float) -> Subset:
        """Return the best set without terms whose held-out gain is not clearly positive, the least clear first.

        The standard error is that over folds, or that of a gain of G nats under the noise model, sqrt(2 G), if it is
        smaller: a drive may excite a term in few of them, as it does a patch of floor.

        errors : number of standard errors that a gain has to exceed zero by
        """
        best = self.best
        while best:
            without = [tuple(j for j in best if j != i) for i in best]
            found = self.evidence.gains([best, *without])
            more = found.folds[0] - found.folds[1:]
            gain = more.sum(axis=1)
            error = np.minimum(more.std(axis=1, ddof=1) * np.sqrt(more.shape[1]), np.sqrt(2.0 * np.maximum(gain, 0.0)))
            clear = gain / (error + 1e-9)
            own = np.full(len(best), np.inf)
            np.subtract(found.score[0], found.score[1:], out=own, where=np.isfinite(found.score[1:]))
            weak = np.flatnonzero((clear < errors) | (own <= 0.0))
            if not len(weak):
                break
            best = without[int(weak[np.argmin(clear[weak])])]
        return best


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
        covariance = pseudo_inverse(normal)
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

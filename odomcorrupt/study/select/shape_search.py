"""Shape search: the member of a family of terms with the largest gain; approximate for all, exact for the best.

Places, thresholds and correlation times are nonlinear parameters. Families are evaluated on grids. From the best
members, coordinate steps of decreasing size lead to the nearest maximum. Once a term is in the model, a simplex varies
all its shape parameters jointly, because the likelihood may have ridges.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize

from odomcorrupt.errors import EffectError
from odomcorrupt.study.select.score import project_out
from odomcorrupt.study.select.screening import CoarseDesign, Screened, coarse_gains, promising_terms
from odomcorrupt.study.terms.term import BasisTerm, LibraryTerm, T, Term, neighbours

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import Decisions

_WIDE, _COARSE = (4.0, 2.0), (1.0, 0.5, 0.25, 0.125)
"""Scales of the steps of a shape search; wide ones for places, whose gain changes only when an edge reaches another
part of the path."""
_SIMPLEX = 0.25
"""Scale of the first simplex."""
_MOST_STEPS, _WORTH_NATS = 12, 0.1  # largest number of steps at each scale; least gain of a step
_MEMBERS = 12
"""Largest number of members of a family among which the starts are."""
_STARTS, _LARGE_NATS = 4, 30.0
"""Number of starting members if the best one gains this many nats, because other maxima may be near.
Below that gain only the best member is a start: its finer features are not significant either."""
_NEAR, _WORTH = 0.03, 0.05
"""Size of the simplex, as a fraction of the first steps, and difference in nats at which it ends."""


class ShapeSearch:
    """Searches over shapes of terms beside the model of a fit.

    design : approximate columns, if already computed for this problem
    """

    def __init__(self, fit: Fit, decisions: Decisions, design: CoarseDesign | None = None) -> None:
        self._fit, self._decisions, self._rest = fit, decisions, project_out(fit)
        self._design = CoarseDesign(fit.problem) if design is None else design
        self._gains: dict[Effect, float] = {}
        self._coarse_gains: dict[Effect, float] = {}

    def gain(self, term: Term) -> float:
        """Return the gain of a term at its shape, nats, from exact columns; 0 if it cannot act."""
        if not isinstance(term, LibraryTerm):
            return self._gain(term)
        if term.start not in self._gains:
            self._gains[term.start] = self._gain(term)
        return self._gains[term.start]

    def _gain(self, term: Term) -> float:
        try:
            columns = term.columns(self._fit.problem)
        except EffectError:  # the term acts on single wheels, and the track is unknown
            return 0.0
        return self._rest.gain(self._fit.noise.whitener.whiten(columns))

    def coarse_gains(self, terms: Sequence[Term]) -> Array:
        """Return the approximate gains (J,) of terms at their shapes, nats."""
        of_library = [term for term in terms if isinstance(term, LibraryTerm)]
        if len(of_library) < len(terms):
            return self._gains_of(terms)
        known = self._coarse_gains
        new = {term.start: term for term in of_library if term.start not in known}
        if new:
            known.update(zip(new, self._gains_of(list(new.values())).tolist(), strict=True))
        return np.array([known[term.start] for term in of_library])

    def _gains_of(self, terms: Sequence[Term]) -> Array:
        return coarse_gains(self._fit, self._rest, self._design.columns(terms), [term.width for term in terms])

    def located(self, family: Sequence[LibraryTerm]) -> list[LibraryTerm]:
        """Return the member of a family with the largest gain for each source of the heading, its shape refined.

        Shapes are compared and refined with approximate columns, except those of effects with memory.
        """
        families = [family, *zip(*(term.with_words(("heading",)) for term in family), strict=True)]
        return [self._located(members) for members in families]

    def _located(self, family: Sequence[LibraryTerm]) -> LibraryTerm:
        if family[0].remembers or len(family) == 1:
            return max(family, key=self.gain)
        nats = self.coarse_gains(family)
        order = np.argsort(-nats, kind="stable")
        begin = starts([family[i] for i in order[:_MEMBERS]], float(nats[order[0]]))
        return max(map(self.climb, begin), key=self.gain)

    def promising(self) -> list[Screened]:
        """Return the best basis functions of every regressor and action, on the grid of their families.

        Rectangles are too many to try everywhere; they are tried around the best disc, if its gain is large.
        """
        found = promising_terms(self._fit, self._rest, self._design)
        disc = max((s for s in found if s.term.function.related), key=lambda s: s.nats, default=None)
        decisions = self._decisions
        most = max((s.nats for s in found), default=0.0)
        least = max(decisions.related_nats, decisions.related_share * most)
        if disc is None or disc.nats < least:
            return found
        place = self.climb(disc.term)
        actions = [place.action, *(a for a in self._design.actions if "both" in a.reaches)]
        related = []
        for function in place.function.related:
            tried = [BasisTerm(function, action) for action in actions]
            turned = self.climb(tried[int(np.argmax(self.coarse_gains(tried)))])
            related.append(Screened(turned, float(self.coarse_gains([turned])[0])))
        return [*found, max(related, key=lambda s: s.nats)]

    def climb(self, term: T) -> T:
        """Return the term at the nearest maximum of the approximate gain; unchanged if it is an effect with memory."""
        if not len(term.shape) or (isinstance(term, LibraryTerm) and term.remembers):
            return term
        wide = _WIDE if isinstance(term, BasisTerm) and term.several_maxima else ()
        (nats,) = self.coarse_gains([term])
        for scale in wide + _COARSE:
            for _ in range(_MOST_STEPS):
                near: list[T] = list(neighbours(term, scale))
                gains = self.coarse_gains(near)
                best = int(np.argmax(gains))
                if not gains[best] > nats + _WORTH_NATS:
                    break
                term, nats = near[best], gains[best]
        return term

    def maximise(self, term: T) -> T:
        """Return the term at the nearest maximum over all shape parameters jointly, from exact columns.

        By a simplex, as edges have no gradient (Nelder and Mead 1965, Computer Journal 7, 308).
        """
        if not len(term.shape):
            return term
        start, steps, none = term.shape, _SIMPLEX * term.steps, np.zeros(len(term.shape))

        def moved(by: Array) -> T:
            return term.with_shape((start + steps * by).tolist())

        simplex = np.vstack((none, np.eye(len(none))))
        options = {"initial_simplex": simplex, "xatol": _NEAR, "fatol": _WORTH}
        return moved(minimize(lambda by: -self.gain(moved(by)), none, method="Nelder-Mead", options=options).x)


def starts(ranked: Sequence[T], nats: float) -> list[T]:
    """Return terms to refine, the best first: one, or if its gain is large, some that may lead to other maxima.

    nats : gain of the best
    """
    chosen = [ranked[0]]
    for term in ranked[1:]:
        if len(chosen) == _STARTS or nats < _LARGE_NATS:
            break
        if all(_apart(term, other) for other in chosen):
            chosen.append(term)
    return chosen


def _apart(one: Term, other: Term) -> bool:
    """Return whether two terms are likely to lead to different maxima."""
    if getattr(one, "action", None) != getattr(other, "action", None) or len(one.shape) != len(other.shape):
        return True
    if isinstance(one, BasisTerm) and isinstance(other, BasisTerm) and one.function.form != other.function.form:
        return True
    return one.several_maxima and bool(np.any(np.abs(one.shape - other.shape) > one.steps))

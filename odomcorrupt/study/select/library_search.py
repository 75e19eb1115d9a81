"""Library search: every effect of the library beside a model, each near its best shape, and at it where that matters.

Most families explain little, and where in them the most is does not change what comes next. So each is located by
approximate columns first, and its shape is refined by exact ones only when its effect may still be selected.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.study.select.score import score_terms
from odomcorrupt.study.select.shape_search import Located, ShapeSearch

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.score import Score
    from odomcorrupt.study.terms.term import LibraryTerm

__all__ = ["LibrarySearch", "Prospect"]


class Prospect(NamedTuple):
    """An effect of the library that has not been decided upon.

    family : which of the families it is the best of, about
    nats, robust_nats : the most that it is likely to gain at its best shape, see `Score`
    exact : whether it is at its best shape
    """

    family: int
    nats: float
    robust_nats: float
    exact: bool


class LibrarySearch:
    """The families of a library beside the model of a fit, in the order of what their effects may explain.

    Parameters
    ----------
    fit, families, decisions : the model, the families that are tested, and what the penalties are made of

    Attributes
    ----------
    scores : of all effects, each where it is located so far

    """

    def __init__(self, fit: Fit, families: Sequence[Sequence[LibraryTerm]], decisions: Decisions) -> None:
        self._fit, self._families, self._decisions = fit, families, decisions
        self._search = ShapeSearch(fit, decisions)
        self._located = [self._search.located(family) for family in families]
        self._columns = [one.term.columns(fit.problem) for one in self._located]
        self._open = set(range(len(families)))
        self.scores = self._scored()

    def likeliest(self) -> Prospect | None:
        """Return the undecided effect that may have the largest robust gain, None where all are decided."""
        prospects = (self._prospect(i) for i in sorted(self._open))
        return max(prospects, key=lambda one: one.robust_nats, default=None)

    def refine(self, prospect: Prospect) -> None:
        """Refine the shape of an effect by exact columns; all are scored again, because tests share a variance."""
        i = prospect.family
        self._located[i] = Located(self._search.best(self._families[i]), exact=True)
        self._columns[i] = self._located[i].term.columns(self._fit.problem)
        self.scores = self._scored()

    def decide(self, prospect: Prospect) -> Score:
        """Return the score of an effect, which is then no prospect any more."""
        self._open.remove(prospect.family)
        return self.scores[prospect.family]

    def scores_above(self, nats: float) -> list[Score]:
        """Return the scores of all effects that gain more than so many nats, each at its best shape."""
        for i in range(len(self._families)):
            prospect = self._prospect(i)
            if not prospect.exact and prospect.nats > nats:
                self.refine(prospect)
        return [score for score in self.scores if score.nats > nats]

    def _scored(self) -> list[Score]:
        terms = [one.term for one in self._located]
        return score_terms(self._fit, terms, self._decisions, columns=self._columns)

    def _prospect(self, i: int) -> Prospect:
        score, located = self.scores[i], self._located[i]
        most = located.at_most(0.5 * score.statistic)
        return Prospect(i, most - score.penalty, most / score.inflation - score.penalty, located.exact)

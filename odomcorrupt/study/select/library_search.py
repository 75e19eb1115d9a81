"""Library search: score of every library effect beside a model, each at or near its best shape.

Most families explain little, and their best shape does not change the next selection. So approximate columns locate
each one first, and its shape is refined with exact columns only if its effect may still be selected.
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


class Prospect(NamedTuple):
    """An effect of the library that awaits a decision.

    family : index of its family
    nats, robust_nats : likely upper bounds on its gains at the best shape, see `Score`
    exact : whether its shape is already the best one
    """

    family: int
    nats: float
    robust_nats: float
    exact: bool


class LibrarySearch:
    """Families of library effects beside the model of a fit, in the order of their likely gains.

    Parameters
    ----------
    fit, families, decisions : the model, the tested families, and the thresholds

    Attributes
    ----------
    scores : scores of all effects at their present shapes
    """

    def __init__(self, fit: Fit, families: Sequence[Sequence[LibraryTerm]], decisions: Decisions) -> None:
        self._fit, self._families, self._decisions = fit, families, decisions
        self._search = ShapeSearch(fit, decisions)
        self._located = [self._search.located(family) for family in families]
        self._columns = [one.term.columns(fit.problem) for one in self._located]
        self._open = set(range(len(families)))
        self.scores = self._scored()

    def likeliest(self) -> Prospect | None:
        """Return the undecided effect that may have the largest robust gain; None if all are decided."""
        prospects = (self._prospect(i) for i in sorted(self._open))
        return max(prospects, key=lambda one: one.robust_nats, default=None)

    def refine(self, prospect: Prospect) -> None:
        """Refine the shape of an effect with exact columns; all are rescored, because the tests share a variance."""
        i = prospect.family
        self._located[i] = Located(self._search.best(self._families[i]), exact=True)
        self._columns[i] = self._located[i].term.columns(self._fit.problem)
        self.scores = self._scored()

    def decide(self, prospect: Prospect) -> Score:
        """Return the score of an effect and mark it as decided."""
        self._open.remove(prospect.family)
        return self.scores[prospect.family]

    def scores_above(self, nats: float) -> list[Score]:
        """Return the scores of all effects with a gain above `nats`, each at its best shape."""
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

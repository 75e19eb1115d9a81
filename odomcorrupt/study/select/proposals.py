"""Proposals: the dependence to include next, beside the effects of a model or in place of some.

Several are compared by refits, each in the form that fits best.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.select.candidates import Candidate, tried, with_shape_refined
from odomcorrupt.study.select.dependence import BasisScore, Dependence
from odomcorrupt.study.select.model_comparison import ModelComparison, explained_share, with_effects
from odomcorrupt.study.terms.basis.heading import functions_of_heading
from odomcorrupt.study.terms.term import BasisTerm

if TYPE_CHECKING:
    from collections.abc import Container, Iterable, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.score import Score

_NEAR_FORM = 0.05
"""Fraction of the best form's gain that another form may recover by refinement of its threshold."""


@dataclass(frozen=True, slots=True)
class Proposal:
    """A dependence whose basis function may be included, and its candidate in the form that fits best."""

    dependence: Dependence
    candidate: Candidate


def best_dependence(
    fit: Fit,
    found: Sequence[Dependence],
    decisions: Decisions,
    *,
    instead_of: ModelComparison | None = None,
) -> Proposal | None:
    """Return the dependence with the largest gain that does not increase the drift, among the most significant ones.

    They are compared by refits: a score test takes the noise as it is without the term, and differs from the gain by
    more than the gains from each other. Robust weights stay fixed, because a fit that excludes more intervals as
    outliers has a larger likelihood; only the fit that is returned has weights of its own.

    instead_of : effects that it replaces, whose gain it has to exceed by `replacement_nats`
    """
    # by chance, a random process depends a little on the motion of one drive
    others, spared, least = fit.effects, 0.0, decisions.replacement_nats if fit.random else 0.0
    if instead_of is not None:
        others = tuple(e for e in fit.effects if e not in instead_of.effects)
        spared, least = instead_of.penalty, decisions.replacement_nats
    have = {effect.name for effect in others}
    possible = [(one, one.best) for one in found if one.best is not None and one.name not in have]
    best, largest = None, -np.inf
    for one, basis in possible[: decisions.shortlist]:
        if one.nats < decisions.shortlist_share * largest:
            break
        forms = [score for score in (basis.score, *basis.others) if score.term.name not in have]
        fits = [(with_it, score) for score in forms if (with_it := with_effects(fit, (*others, score.estimated), fit))]
        if not fits:
            continue
        # a step and a hinge are compared with their thresholds refined
        most = max(map(_worth, fits))
        near = max(decisions.replacement_nats, _NEAR_FORM * (most - fit.log_likelihood))
        refined = [with_shape_refined(*pair, decisions, fit) for pair in fits if _worth(pair) >= most - near]
        with_it, score = max(refined, key=_worth)
        known = _where_known(score, with_it, others, decisions)
        if known is not score:
            with_it, score = with_it.refit((*others, known.estimated), weights_of=fit), known
        gain = with_it.log_likelihood - fit.log_likelihood - score.penalty + spared
        # what the data do not separate stays in the order of the robust score tests
        more = best.candidate.gain + decisions.alternative_nats if best else least
        candidate = tried(fit, with_it, score, gain=gain, least=more)
        if not candidate.refused:
            best, largest = Proposal(_reshaped(one, score), candidate), max(largest, one.nats)
    final = best and best.candidate.fit
    return replace(best, candidate=replace(best.candidate, fit=final.refit())) if best and final else best


def _where_known(score: Score, with_it: Fit, others: Sequence[Effect], decisions: Decisions) -> Score:
    """Return a score, confined to the headings driven if it is of a wave whose period these do not show.

    A wave of another period may explain the same there, within `alternative_nats`, and differ at all other headings.

    with_it, others : fit with the dependence, and its other effects
    """
    term = score.term
    if not isinstance(term, BasisTerm) or term.function.regressor != "heading":
        return score
    problem, whiten = with_it.problem, with_it.noise.whitener.whiten
    law = next(effect for effect in with_it.effects if effect.name == term.name)
    explained = whiten(term.columns(problem)) @ [getattr(law, p.name) for p in amplitudes(law)]
    beside = [problem.columns(effect) for effect in others]
    for wave in (one for one in functions_of_heading() if one.text != term.function.text):
        instead = whiten(np.concatenate((replace(term, function=wave).columns(problem), *beside), axis=2))
        lost_nats = 0.5 * (1.0 - explained_share(instead, explained)) * float(explained @ explained)
        if lost_nats < decisions.alternative_nats:
            return replace(score, term=term.where_driven(problem.motions))
    return score


def _worth(included: tuple[Fit, Score]) -> float:
    """Return the log likelihood of a fit minus the penalty of the term that it includes."""
    return included[0].log_likelihood - included[1].penalty


def _reshaped(one: Dependence, score: Score) -> Dependence:
    """Return a dependence with the form of its basis function that fits best."""
    if one.best is None or score is one.best.score:
        return one
    best = BasisScore(score)
    return replace(one, best=best, expression=best.term.expression(score.estimate.tolist()))


def best_replacement(
    fit: Fit, compared: Iterable[ModelComparison], decisions: Decisions, contradicted: Container[str] = ()
) -> Proposal | None:
    """Return the dependence with the largest gain over the included effects that it replaces, and the fit with it.

    contradicted : channels on which no dependence is admitted
    """
    found, least = list[Proposal](), np.inf
    for own in sorted(compared, key=lambda own: own.margin):
        if own.margin > least:
            break  # whatever is redundant beside the first replacements is dropped later anyway
        better = [one for one in own.better(decisions.replacement_nats) if one.channel not in contradicted]
        if proposal := best_dependence(fit, better, decisions, instead_of=own):
            found.append(proposal)
            least = min(least, own.margin + decisions.alternative_nats)
    return max(found, key=lambda one: one.candidate.gain, default=None)

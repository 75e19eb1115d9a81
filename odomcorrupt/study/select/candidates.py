"""Candidates for the next inclusion: terms that are tested, refitted with the model, and admitted or refused.

A candidate is admitted only if it passes both score tests, gains on held-out blocks, has a physically possible size
with a small enough standard error, and gains in a joint refit.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.effect import amplitudes, choices, on_bound
from odomcorrupt.effects.expression import CHANNELS
from odomcorrupt.errors import EffectError, FitError
from odomcorrupt.study.estimate.drift_error import ten_second_error
from odomcorrupt.study.estimate.heading_source import sees_travel
from odomcorrupt.study.select.decisions import error_shares
from odomcorrupt.study.select.elimination import drop_term
from odomcorrupt.study.select.library_search import LibrarySearch
from odomcorrupt.study.select.periodic import flat_spots
from odomcorrupt.study.select.shape_search import ShapeSearch
from odomcorrupt.study.terms.library import library_families
from odomcorrupt.study.terms.term import LibraryTerm

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Sequence

    from odomcorrupt.effects.effect import Effect, Parameter
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.score import Score
    from odomcorrupt.study.terms.term import Term

_HALVINGS = 20
"""Number of bisections of a parameter's range for a starting value."""
_IMPOSSIBLE_SIGN = "of a physically impossible sign"
"""Refusal of an effect whose estimate has a physically impossible sign."""
_WITHDRAWN = "gains nothing once outlier segments are weighted again, or leads back to an earlier model"


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A scored term and, if it was shortlisted, the whole model refitted with it.

    fit : the refit; None if there was none, and in reports, because fits of long drives are large
    fitted : the effect as it was refitted; None if it was not
    gain : log likelihood gained by the refit minus the penalty, nats
    rmse : 10 s position error of the fitted data without and with the term, m
    refused : reason for the refusal; "" if admitted
    """

    score: Score
    fit: Fit | None = None
    fitted: Effect | None = None
    gain: float = float("-inf")
    rmse: tuple[float, float] = (float("nan"), float("nan"))
    refused: str = ""

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.score.term.name

    def contradicts_physics(self, decisions: Decisions) -> bool:
        """Return whether the data support the effect only with a physically impossible sign, so have another flaw.

        Tyres do not slip inwards, and no response precedes its cause. Effects of commanded or lost motion are excepted,
        because their opposite is possible: instead of losing counts above a speed, a drive may saturate or slip there.
        """
        return _IMPOSSIBLE_SIGN in self.refused and self.name not in decisions.commanded


def library(fit: Fit) -> list[tuple[LibraryTerm, ...]]:
    """Return the systematic effects that the robot can have and the model lacks, each as a family of shapes."""
    problem = fit.problem
    have = {effect.name for effect in fit.effects}
    families = library_families(problem.recordings, problem.motions, have)
    return families if "flat_spot" in have else [*families, *flat_spots(fit)]


def terms_of(fit: Fit) -> frozenset[str]:
    """Return the names and channels of the effects and random coefficients of a model, and "clock" if one is free."""
    clocks = ["clock"] if np.any(fit.free_clocks) else []
    return frozenset([*clocks, *(f"{e.name} {getattr(e, 'channel', '')}" for e in (*fit.effects, *fit.random))])


def library_candidates(fit: Fit, decisions: Decisions, withdrawn: Container[str] = ()) -> list[Candidate]:
    """Return all effects of the library as candidates: the admitted ones first, in order of their gains.

    withdrawn : names of effects that were admitted to this model and removed again
    """
    candidates = [
        replace(c, refused=_WITHDRAWN) if c.name in withdrawn and not c.refused else c
        for c in _candidates(fit, decisions)
    ]
    return sorted(candidates, key=_rank, reverse=True)


def _rank(candidate: Candidate) -> tuple[bool, float, float]:
    return (candidate.refused == "", candidate.gain, -candidate.score.p)


def _candidates(fit: Fit, decisions: Decisions) -> Iterator[Candidate]:
    """Yield all effects of the library as candidates, in decreasing order of their likely gains.

    A shape is refined with exact columns only if its effect may still reach the shortlist.
    """
    search = LibrarySearch(fit, library(fit), decisions)
    refits, leader = 0, -np.inf
    while (best := search.likeliest()) is not None:
        unlikely = refits == decisions.shortlist or best.robust_nats < decisions.shortlist_share * leader
        if not best.exact and not unlikely and best.nats > 0.0:
            search.refine(best)
            continue
        score = search.decide(best)
        level = levels_of(search.scores, decisions)[score.term.name]
        refused = objection(fit, score, decisions, level=level)
        if refused or unlikely or not best.exact:
            yield Candidate(score=score, refused=refused or "others explain it better")
            continue
        refits += 1
        candidate = _refitted(fit, score)
        if not candidate.refused:
            # a refused candidate does not raise the threshold for the others
            leader = max(leader, score.robust_nats)
        yield candidate


def levels_of(scores: Sequence[Score], decisions: Decisions) -> dict[str, float]:
    """Return the significance level of each effect of a joint test, by name.

    All p values are corrected with equal weights; the levels account for prior probabilities, see `error_shares`.
    """
    names = [score.term.name for score in scores if score.separable]
    shares = error_shares(names, decisions)
    levels = {name: decisions.level * len(names) * share for name, share in zip(names, shares, strict=True)}
    return {score.term.name: levels.get(score.term.name, decisions.level) for score in scores}


def objection(fit: Fit, score: Score, decisions: Decisions, *, level: float) -> str:
    """Return the reason to refuse an effect of the library before any refit; "" if there is none.

    level : significance level of the effect
    """
    if not score.separable:
        return "not separable from what is in the model"
    own = list(zip(amplitudes(score.effect), score.estimate, score.standard_error, strict=True))
    for p, value, error in own:
        least = 2.0 * error * decisions.testable_errors
        bound = np.copysign(p.high if value > 0.0 else -p.low, value)
        if max(p.high, -p.low) < least and _first_order_room(fit, score.effect, p, bound) < least:
            return "not testable on this drive"
    if not score.significant(level):
        return "no evidence" if score.p >= level else "does not gain on held-out blocks"
    for p, value, _ in own:
        room = p.high if value > 0.0 else -p.low
        if abs(value) > room and abs(value) > _first_order_room(fit, score.effect, p, np.copysign(room, value)):
            why = "beyond what is physically possible" if room > 0.0 else _IMPOSSIBLE_SIGN
            return f"{p.name} would be {f'{value:.3g} {p.unit}'.rstrip()}, {why}"
    return ""


def _first_order_room(fit: Fit, effect: Effect, p: Parameter, bound: float) -> float:
    """Return the first-order estimate that corresponds to a parameter at its bound.

    The error may be non-linear in the parameter. A robot whose track is a quarter of the nominal one turns four times
    as far as its odometry: three times the reported turn is missing, so the first-order estimate is 3.
    """

    def size(value: float) -> float:
        acting = replace(effect, **{p.name: value})  # type: ignore[type-var]  # effects are dataclasses
        return float(np.sqrt(sum(np.sum(error_of(acting, m) ** 2) for m in fit.problem.motions)))

    slope = size(p.identity + np.copysign(p.step, bound)) / p.step
    return size(bound) / slope if slope > 0.0 else 0.0


def _started(fit: Fit, score: Score) -> Effect:
    """Return the effect at its estimate; beyond a bound, at the value whose error is as large as the estimated one."""
    own = amplitudes(score.effect)
    value = float(score.estimate[0])
    low, high = own[0].identity, own[0].high if value > 0.0 else own[0].low
    if len(own) > 1 or abs(value) <= abs(high - low):
        return score.estimated
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        below = _first_order_room(fit, score.effect, own[0], middle) < abs(value)
        low, high = (middle, high) if below else (low, middle)
    return score.term.effect([low])


def _refitted(fit: Fit, score: Score) -> Candidate:
    """Return a candidate fitted jointly with the model; robust weights stay fixed, so that likelihoods compare."""
    effects = (*fit.effects, _started(fit, score))
    # an effect that scales turns also scales their noise, a scale error of a gyro does not: the two are comparable
    # only to first order, with the same noise
    alike = None if sees_travel(fit.problem.recordings) else score.nats
    candidate = tried(fit, fit.refit(effects, weights_of=fit), score, gain=alike)
    if candidate.gain > 0.0 or not np.any(fit.free_clocks) or candidate.fit is None:
        return candidate
    # interpolated odometry is smoother between stamps: if the clock had drifted there, its return looks like a loss
    held = fit.refit(effects, weights_of=fit, free_clocks=[(False, False)] * len(fit.free_clocks))
    return tried(fit, candidate.fit, score, gain=held.log_likelihood - fit.log_likelihood - score.penalty)


def tried(fit: Fit, with_it: Fit, score: Score, *, gain: float | None = None, least: float = 0.0) -> Candidate:
    """Return a term as a candidate, admitted if the fit with it gains.

    gain : default the gain in log likelihood minus the penalty, nats; least : gain required, nats
    """
    if gain is None:
        gain = with_it.log_likelihood - fit.log_likelihood - score.penalty
    refit = Candidate(score=score, fit=with_it, fitted=with_it.by_name.get(score.term.name), gain=gain)
    beyond = _on_bounds(with_it, score)
    if beyond:
        return replace(refit, refused=beyond)
    refused = "gains nothing when everything is fitted together" if gain <= least else ""
    return replace(refit, rmse=(ten_second_error(fit), ten_second_error(with_it)), refused=refused)


def channels_of(fit: Fit, effect: Effect) -> list[str]:
    """Return the channels on which an effect acts."""
    changed = {p.name: p.identity + p.step for p in amplitudes(effect)}
    acting = replace(effect, **changed)  # type: ignore[type-var]  # effects are dataclasses
    acts = np.any([np.abs(error_of(acting, m)).max(axis=0) > 0.0 for m in fit.problem.motions], axis=0)
    return [channel for channel, does in zip(CHANNELS, acts, strict=True) if does]


def _on_bounds(fit: Fit, score: Score) -> str:
    """Return the reason for refusal if a fitted parameter is on its bound; else ""."""
    reached = next((on_bound(e) for e in fit.onward.effects if e.name == score.term.name), None)
    return f"{reached[0]} would be {reached[1]:.3g} or more, beyond what is physically possible" if reached else ""


def with_shape_refined(
    fit: Fit, score: Score, decisions: Decisions, weights_of: Fit | None = None
) -> tuple[Fit, Score]:
    """Return the fit with the shape of one of its terms refined, beside noise estimated with the term in the model.

    Word-valued parameters with the same first-order effect (filter or delay) are compared by refits.

    score : the term in its present shape; fit and score are returned unchanged if another shape gains too little
    weights_of : fit whose robust weights are kept for comparison with other fits; default: re-estimated
    """
    fit, score = _with_words_refined(fit, score, decisions)
    if len(score.term.shape) or (isinstance(score.term, LibraryTerm) and score.term.trials > 1):
        return _with_shape_moved(fit, score, decisions, weights_of)
    return fit, score


def _with_shape_moved(fit: Fit, score: Score, decisions: Decisions, weights_of: Fit | None) -> tuple[Fit, Score]:
    """Return the fit with the shape of one of its terms at the maximum by the columns of a small effect."""
    effect = next(e for e in fit.effects if e.name == score.term.name)
    search = ShapeSearch(drop_term(fit, effect), decisions)
    moved = search.maximise(_nearby(search, score.term, fit))
    if np.array_equal(moved.shape, score.term.shape) and moved.start == score.term.start:
        return fit, score
    values = [getattr(effect, p.name) for p in amplitudes(effect)]
    others = [e for e in fit.effects if e is not effect]
    try:
        # the same weights: with weights of its own, the fit that excludes more intervals would be the likelier
        shaped = fit.refit((*others, moved.effect(values)), weights_of=fit)
    except FitError:  # too far off to start from
        return fit, score
    if not shaped.log_likelihood > fit.log_likelihood + decisions.reshape_nats:
        return fit, score
    return shaped.refit(weights_of=weights_of), replace(score, term=moved)


def _with_words_refined(fit: Fit, score: Score, decisions: Decisions) -> tuple[Fit, Score]:
    """Return the fit with the word-valued parameters of a term chosen by refits, except the source of the heading.

    Robust weights stay fixed, so that likelihoods can be compared.
    """
    if not isinstance(score.term, LibraryTerm):
        return fit, score
    effect = next(e for e in fit.effects if e.name == score.term.name)
    for word in choices(effect):
        best = fit
        for other in score.term.with_words((word,)) if word != "heading" else ():
            said = replace(effect, **{word: getattr(other.start, word)})  # type: ignore[type-var]  # a dataclass
            try:
                tried_fit = fit.refit([said if e is effect else e for e in fit.effects], weights_of=fit)
            except EffectError:  # the effect acts on single wheels, and the track is unknown
                continue
            if tried_fit.log_likelihood - best.log_likelihood > decisions.reshape_nats:
                best, chosen = tried_fit, other
        if best is not fit:
            fit, score = best.refit(), replace(score, term=chosen)
            effect = next(e for e in fit.effects if e.name == score.term.name)
    return fit, score


def _nearby(search: ShapeSearch, term: Term, fit: Fit) -> Term:
    """Return the starting point for the final maximisation: for a library effect, the best of its whole family."""
    if isinstance(term, LibraryTerm):
        return search.best((term, *LibraryTerm.family(type(term.start), fit.problem.motions)))
    return search.climb(term)

"""Candidates: terms that may come next, tested, refitted together with the model, and admitted or refused.

A candidate is admitted only if both score tests pass, it gains on blocks held out of its estimate, its size is
physically possible and well enough known, it gains when everything is fitted together, and the 10 s drift of the data
it was fitted on hardly grows (a likelihood alone may want a cause that improves single steps and spoils the path). Two
causes may make up for each other on the path, though: one that spoils it is admitted after all where, beside the next
one, the drift falls.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import amplitudes, choices
from odomcorrupt.effects.expression import CHANNELS
from odomcorrupt.errors import EffectError, FitError
from odomcorrupt.geometry.motion import error_of
from odomcorrupt.study.estimate.drift_error import drift
from odomcorrupt.study.estimate.truth_bias import has_bias
from odomcorrupt.study.estimate.windows import WINDOW_S
from odomcorrupt.study.select.closed_loop import (
    acts_in_curves_only,
    hardly_turns,
    is_gain_of_turns,
    may_be_of_lags,
    may_be_steering,
    of_pulls,
)
from odomcorrupt.study.select.decisions import error_shares
from odomcorrupt.study.select.elimination import drop_term
from odomcorrupt.study.select.library_search import LibrarySearch
from odomcorrupt.study.select.periodic import flat_spots
from odomcorrupt.study.select.score import project_out
from odomcorrupt.study.select.shape_search import ShapeSearch
from odomcorrupt.study.terms.drive_type import library_families
from odomcorrupt.study.terms.heading_source import sees_travel
from odomcorrupt.study.terms.term import LibraryTerm

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Sequence

    from odomcorrupt.effects.effect import Effect, Parameter
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.drift_error import Drift
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.score import Score
    from odomcorrupt.study.terms.term import Term

__all__ = [
    "Candidate",
    "channels_of",
    "include",
    "levels_of",
    "library",
    "library_candidates",
    "objection",
    "terms_of",
    "tried",
    "with_shape_refined",
]

_FORBIDDEN = "of a sign that it cannot have"
"""Why a cause is refused that explains the data by what it cannot do."""
_SPOILS = f"makes the {WINDOW_S:g} s error larger"
_STILL, _CREEP = 0.02, 0.1
"""m/s and rad/s below which a robot stands, and for slow robots in parts of what is usual."""
_WITHDRAWN = "gains nothing once outlier segments are weighted again, or leads back to an earlier model"
_AT_BOUND = 1e-6
"""Part of a parameter's range from its bound within which a fit has run into it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A scored term, and where it made the shortlist, the whole model refitted with it.

    gain : log likelihood gained by the refit less the penalty, nats
    rmse : 10 s position error of the fitted data before and after, m
    refused : why it is not admitted, or empty
    """

    score: Score
    fit: Fit | None = None
    gain: float = float("-inf")
    rmse: tuple[float, float] = (float("nan"), float("nan"))
    refused: str = ""

    @property
    def name(self) -> str:
        """Name of the effect."""
        return self.score.term.name

    def contradicts_physics(self, decisions: Decisions) -> bool:
        """Return whether data speak for an effect of a sign that physics forbids, and so have another flaw.

        Tyres do not slip inwards, and nothing comes before its cause. But the opposite of counts lost above a speed is
        a drive that saturates or slips there: of a cause of commanded or lost motion it is some other cause.
        """
        return _FORBIDDEN in self.refused and self.name not in decisions.commanded


def library(fit: Fit) -> list[tuple[LibraryTerm, ...]]:
    """Return every systematic effect that the robot can have and the model does not, as a family of shapes."""
    problem = fit.problem
    have = {effect.name for effect in fit.effects}
    families = library_families(problem.recordings, problem.motions, have)
    return families if "flat_spot" in have else [*families, *flat_spots(fit)]


def terms_of(fit: Fit) -> frozenset[str]:
    """Return what a model has, by name and channel, clocks that are off too."""
    clocks = ["clock"] if np.any(fit.free_clocks) else []
    return frozenset([*clocks, *(f"{e.name} {getattr(e, 'channel', '')}" for e in (*fit.effects, *fit.random))])


def library_candidates(fit: Fit, decisions: Decisions, withdrawn: Container[str] = ()) -> list[Candidate]:
    """Return all effects of the library as candidates, admitted ones first and by gain.

    withdrawn : names of effects that this model did not keep
    """
    candidates = [
        replace(c, refused=_WITHDRAWN) if c.name in withdrawn and not c.refused else c
        for c in _candidates(fit, decisions)
    ]
    best = max((c.gain for c in candidates if not c.refused), default=0.0)
    excused = [_excused(c, decisions) if c.refused == _SPOILS and c.gain > best else c for c in candidates]
    ranked = sorted(excused, key=_rank, reverse=True)
    return [*ranked[:1], *(_lighter(c) for c in ranked[1:])]


def _lighter(candidate: Candidate) -> Candidate:
    """Return a candidate that is not selected without what only a refit would use: it is kept for reports."""
    if candidate.fit is None:
        return candidate
    problem = replace(candidate.fit.problem, smoothers=(), left=())
    return replace(candidate, fit=replace(candidate.fit, problem=problem))


def _excused(candidate: Candidate, decisions: Decisions) -> Candidate:
    """Return the candidate admitted, where what comes next makes good the path that it spoils alone."""
    if candidate.fit is None:
        return candidate
    following = (c for c in _candidates(candidate.fit, decisions) if not c.refused)
    made_good = any(c.rmse[1] <= candidate.rmse[0] for c in following)
    return replace(candidate, refused="") if made_good else candidate


def _rank(candidate: Candidate) -> tuple[bool, float, float]:
    return (candidate.refused == "", candidate.gain, -candidate.score.p)


def _candidates(fit: Fit, decisions: Decisions) -> Iterator[Candidate]:
    """Yield all effects of the library as candidates, those first that are likely to explain most.

    A shape is refined by exact columns only where its effect may still make the shortlist.
    """
    search = LibrarySearch(fit, library(fit), decisions)
    still = hardly_turns(fit)
    refits, leader = 0, -np.inf
    while (best := search.likeliest()) is not None:
        unlikely = refits == decisions.shortlist or best.robust_nats < decisions.shortlist_share * leader
        if not best.exact and not unlikely and best.nats > 0.0:
            search.refine(best)
            continue
        score = search.decide(best)
        level = levels_of(search.scores, decisions)[score.term.name]
        refused = objection(fit, score, decisions, level=level, still=still)
        if refused or unlikely or not best.exact:
            yield Candidate(score=score, refused=refused or "others explain it better")
            continue
        refits += 1
        candidate = _refitted(fit, score, decisions)
        if not candidate.refused:
            # one that cannot be had stands in nobody's way
            leader = max(leader, score.robust_nats)
        yield candidate


def levels_of(scores: Sequence[Score], decisions: Decisions) -> dict[str, float]:
    """Return the level for the p of each effect that was tested with the others, by name.

    Every p counts the family as if its members were alike a priori; they are not, see `error_shares`.
    """
    names = [score.term.name for score in scores if score.separable]
    shares = error_shares(names, decisions)
    levels = {name: decisions.level * len(names) * share for name, share in zip(names, shares, strict=True)}
    return {score.term.name: levels.get(score.term.name, decisions.level) for score in scores}


def objection(fit: Fit, score: Score, decisions: Decisions, *, level: float, still: bool) -> str:
    """Return why an effect of the library is out of question, or nothing.

    level : what its p has to be below; still : the robot hardly turns
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
            why = "beyond what is physically possible" if room > 0.0 else _FORBIDDEN
            return f"{p.name} would be {value:.3g}, {why}"
    if score.effect.name != "channel_lag" and (of_pulls(fit, score.estimated) or may_be_of_lags(fit, score)):
        return "no larger than what a filter makes that comes late, or is given poses as well"
    return _made_by_noise(fit, score, still=still)


def _made_by_noise(fit: Fit, score: Score, *, still: bool) -> str:
    """Return by which noise an effect may be made that data speak for otherwise, or nothing."""
    columns = score.term.columns(fit.problem)
    if _shows_at_rest_only(fit, score, columns):
        return "shows only while the robot stands, and moves nothing there by itself"
    answers = is_gain_of_turns(fit, columns) and may_be_steering(fit, columns, score.estimate)
    steered = answers or (still and acts_in_curves_only(fit, score.effect))
    return "turns no larger than the noise: it may be a driver who steers back" if steered else ""


def _shows_at_rest_only(fit: Fit, score: Score, columns: Array) -> bool:
    """Tell whether an effect of the motion explains nothing but intervals in which the odometry creeps at best.

    Noise that grows with the motion hardly allows for creep: a millimetre a second is plain, and any cause fits it that
    takes slow motion away. What acts at rest, such as a gyro's bias, may well show there alone.
    """
    nodes = fit.problem.nodes
    rates = np.stack((nodes.distance_m, np.abs(nodes.odometry_step[:, 2]))) / (nodes.end_s - nodes.start_s)
    still = np.minimum(_STILL, _CREEP * np.quantile(rates, 0.9, axis=1, keepdims=True))
    moving = np.repeat((rates > still).any(axis=0), 3)
    if moving.all():
        return False
    rest = project_out(fit)
    column, residual = rest.of(fit.noise.whitener.whiten(columns))[moving], rest.residual[moving]
    explained = 0.5 * float((column @ np.linalg.lstsq(column, residual, rcond=None)[0]) @ residual)
    return explained < score.penalty and not _acts_at_rest(fit, score.estimated)


def _acts_at_rest(fit: Fit, effect: Effect) -> bool:
    """Tell whether an effect moves the odometry of a robot that stands."""
    for m in fit.problem.motions:
        none = np.zeros(len(m))
        if error_of(effect, replace(m, v=none, vy=none, omega=none, acceleration=0.0 * m.acceleration)).any():
            return True
    return False


def _first_order_room(fit: Fit, effect: Effect, p: Parameter, bound: float) -> float:
    """Return how large an estimate of first order may be of a parameter that reaches its bound.

    A robot that turns four times as far as its odometry says has a track of a quarter: three times its odometry's turns
    are missing, and a parameter of three would say so to first order.
    """

    def size(value: float) -> float:
        acting = replace(effect, **{p.name: value})  # type: ignore[type-var]  # effects are dataclasses
        return float(np.sqrt(sum(np.sum(error_of(acting, m) ** 2) for m in fit.problem.motions)))

    slope = size(p.identity + np.copysign(p.step, bound)) / p.step
    return size(bound) / slope if slope > 0.0 else 0.0


def _refitted(fit: Fit, score: Score, decisions: Decisions) -> Candidate:
    """Return a candidate fitted together with the model, robust weights kept so that likelihoods compare."""
    effects, weights = (*fit.effects, score.estimated), fit.noise.weights
    # an effect that scales turns scales their noise, and a scale error of a gyro does not: only to first order, with
    # the same noise, does the one compare with the other
    alike = None if sees_travel(fit.problem.recordings) else score.nats
    candidate = tried(fit, fit.refit(effects, weights=weights), score, decisions, gain=alike)
    if candidate.gain > 0.0 or not np.any(fit.free_clocks) or candidate.fit is None:
        return candidate
    # between two stamps odometry is smoother: where the clock had strayed there, coming back looks like a loss
    held = fit.refit(effects, weights=weights, free_clocks=[(False, False)] * len(fit.free_clocks))
    return tried(fit, candidate.fit, score, decisions, gain=held.log_likelihood - fit.log_likelihood - score.penalty)


def tried(
    fit: Fit, with_it: Fit, score: Score, decisions: Decisions, *, gain: float | None = None, least: float = 0.0
) -> Candidate:
    """Return a term as a candidate, admitted if the fit with it gains and hardly drifts more than the one without.

    gain : default what the likelihood gains less the penalty; least : what it has to
    """
    if gain is None:
        gain = with_it.log_likelihood - fit.log_likelihood - score.penalty
    beyond = _on_bounds(with_it, score)
    if beyond:
        return Candidate(score=score, fit=with_it, gain=gain, refused=beyond)
    before, after = drift(fit), drift(with_it)
    spoiled = _worse(after, before, decisions)
    if spoiled and has_bias(fit.problem):
        # a scale that drifts from the truth's own wrong one to another wrong one spoils nothing
        spoiled = _worse(drift(with_it, truths_scaled=True), drift(fit, truths_scaled=True), decisions)
    refused = "gains nothing when everything is fitted together" if gain <= least else _SPOILS if spoiled else ""
    return Candidate(score=score, fit=with_it, gain=gain, rmse=(before.rmse, after.rmse), refused=refused)


def _worse(after: Drift, before: Drift, decisions: Decisions) -> bool:
    return after.worse_than(
        before, factor=decisions.drift_factor, plain=decisions.drift_plain, errors=decisions.drift_errors
    )


def channels_of(fit: Fit, effect: Effect) -> list[str]:
    """Return the channels that an effect acts on."""
    changed = {p.name: p.identity + p.step for p in amplitudes(effect)}
    acting = replace(effect, **changed)  # type: ignore[type-var]  # effects are dataclasses
    acts = np.any([np.abs(error_of(acting, m)).max(axis=0) > 0.0 for m in fit.problem.motions], axis=0)
    return [channel for channel, does in zip(CHANNELS, acts, strict=True) if does]


def _on_bounds(fit: Fit, score: Score) -> str:
    """Return why a fitted term is not possible, or nothing: a parameter that runs into its bound is no cause."""
    effect = next((e for e in fit.onward.effects if e.name == score.term.name), None)
    for p in amplitudes(effect) if effect is not None else ():
        value = getattr(effect, p.name)
        if value != p.identity and min(value - p.low, p.high - value) <= _AT_BOUND * (p.high - p.low):
            return f"{p.name} would be {value:.3g} or more, beyond what is physically possible"
    return ""


def include(fit: Fit, score: Score, decisions: Decisions) -> tuple[Fit, Score]:
    """Return the fit with a term, robust weights estimated again and its shape refined, and the term as it is then.

    What looked like outliers may be explained now.
    """
    return with_shape_refined(fit.refit((*fit.effects, score.estimated)), score, decisions)


def with_shape_refined(fit: Fit, score: Score, decisions: Decisions) -> tuple[Fit, Score]:
    """Return the fit with the shape of one of its terms searched again, now that what it explains is no noise any more.

    Words that are the same to first order (a filter, a delay) only a refit tells apart.

    score : the term as it is in the model; both come back as they were where another shape gains too little
    """
    fit, score = _with_words_refined(fit, score, decisions)
    if not len(score.term.shape):
        return fit, score
    effect = next(e for e in fit.effects if e.name == score.term.name)
    search = ShapeSearch(drop_term(fit, effect), decisions)
    moved = search.maximise(_nearby(search, score.term, fit))
    if np.array_equal(moved.shape, score.term.shape) and moved.start == score.term.start:
        return fit, score
    values = [getattr(effect, p.name) for p in amplitudes(effect)]
    others = [e for e in fit.effects if e is not effect]
    try:
        shaped = fit.refit((*others, moved.effect(values)))
    except FitError:  # too far off to start from
        return fit, score
    if not shaped.log_likelihood > fit.log_likelihood + decisions.reshape_nats:
        return fit, score
    return shaped, replace(score, term=moved)


def _with_words_refined(fit: Fit, score: Score, decisions: Decisions) -> tuple[Fit, Score]:
    """Return the fit with those words of one of its terms, the source of the heading apart, that a refit prefers."""
    if not isinstance(score.term, LibraryTerm):
        return fit, score
    effect = next(e for e in fit.effects if e.name == score.term.name)
    for word in choices(effect):
        best = fit
        for other in score.term.with_words((word,)) if word != "heading" else ():
            said = replace(effect, **{word: getattr(other.start, word)})  # type: ignore[type-var]  # a dataclass
            try:
                tried_fit = fit.refit([said if e is effect else e for e in fit.effects])
            except EffectError:  # it acts on single wheels, and the track is not known
                continue
            if tried_fit.log_likelihood > best.log_likelihood + decisions.reshape_nats:
                best, chosen = tried_fit, other
        if best is not fit:
            fit, score = best, replace(score, term=chosen)
            effect = next(e for e in fit.effects if e.name == score.term.name)
    return fit, score


def _nearby(search: ShapeSearch, term: Term, fit: Fit) -> Term:
    """Return a term at the maximum to climb from: for an effect of the library, its whole family is tried again."""
    if isinstance(term, LibraryTerm):
        return search.best((term, *LibraryTerm.family(type(term.start), fit.problem.motions)))
    return search.climb(term)

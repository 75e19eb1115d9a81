"""Look for what is missing, one effect at a time, each believed exactly before the next is named.

An effect is admitted only if both gates of the score test pass, it gains on blocks held out of its estimate, its size
is physically possible and well enough known, and the drift over 10 s of the data it was fitted on hardly grows
(a likelihood alone may want a cause that improves single steps and spoils the path). Two causes may make up for each
other on the path, though: one that spoils it is admitted after all where, beside the next one, the drift falls.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import amplitudes, parameters
from odomcorrupt.study.estimate.drift_error import drift
from odomcorrupt.study.estimate.gauss_newton import Fit, believed_columns, fit
from odomcorrupt.study.estimate.windows import WINDOW_S
from odomcorrupt.study.select.closed_loop import acts_in_curves_only, hardly_turns, is_gain_of_turns, may_be_steering
from odomcorrupt.study.select.score import Score, score_tests
from odomcorrupt.study.select.shape_search import Members
from odomcorrupt.study.terms.regressors import drives_sideways

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect

__all__ = ["Candidate", "library", "next_effect", "price"]

LEVEL = 0.01
"""Probability of naming any effect on data without one."""
_SHORTLIST = 4
_WORTH_A_REFIT = 0.25
"""Part of the leader's evidence below which a refit would not turn the tables."""
_SPOILS = f"makes the {WINDOW_S:g} s error larger"
_KNOWN = 4.2
"""An effect is testable if this many of its standard errors fit into half of what is physically possible."""


@dataclass(frozen=True, slots=True)
class Candidate:
    """A score, and where the effect made the shortlist, the whole model refitted with it.

    gain : log likelihood gained by the refit, nats, less what its parameters would gain by chance (k/2 ln K)
    rmse_s : 10 s error of the fitted data before and after, metres
    refused : why it is not admitted, or empty
    """

    score: Score
    fit: Fit | None = None
    gain: float = float("-inf")
    rmse: tuple[float, float] = (float("nan"), float("nan"))
    refused: str = ""


def library(fitted: Fit) -> list[tuple[Effect, ...]]:
    """Return every registered systematic effect that the model does not have, at its identity.

    An effect with shapes comes as the family of shapes worth trying. Clocks are apart, a twin is named as an
    alternative of the one it cannot be told from, single wheels need a track, and not every robot drives sideways.
    """
    have = {effect.name for effect in fitted.effects}
    motions = fitted.problem.motions
    track, sideways = all(m.track_m is not None for m in motions), drives_sideways(motions)
    kinds = [
        kind
        for name, kind in registry().items()
        if name not in have
        and kind.kind not in ("noise", "event")
        and not kind.clock
        and kind.twin_of is None
        and (sideways or not kind.needs_sideways)
    ]
    families = [tuple(kind.scan(motions)) for kind in kinds if track or not kind.needs_track]
    return [family for family in families if family]


def next_effect(fitted: Fit, free_clocks: Sequence[tuple[bool, bool]]) -> list[Candidate]:
    """Return all candidates, the ones that may be added first and in order of evidence."""
    candidates = _candidates(fitted, free_clocks)
    best = max((c.gain for c in candidates if not c.refused), default=0.0)
    excused = [_excused(c, free_clocks) if c.refused == _SPOILS and c.gain > best else c for c in candidates]
    return sorted(excused, key=_rank, reverse=True)


def _excused(candidate: Candidate, free_clocks: Sequence[tuple[bool, bool]]) -> Candidate:
    """Return the candidate admitted, where what comes next makes good the path that it spoils alone."""
    if candidate.fit is None:
        return candidate
    following = [c for c in _candidates(candidate.fit, free_clocks) if not c.refused]
    made_good = any(c.rmse[1] <= candidate.rmse[0] for c in following)
    return replace(candidate, refused="") if made_good else candidate


def _rank(candidate: Candidate) -> tuple[bool, float, float]:
    return (candidate.refused == "", candidate.gain, -candidate.score.p)


def _candidates(fitted: Fit, free_clocks: Sequence[tuple[bool, bool]]) -> list[Candidate]:
    believed = believed_columns(fitted.problem, free_clocks)
    families = library(fitted)
    look = Members(fitted, believed)
    members = [look.best(family) for family in families]
    scores = score_tests(fitted, members, believed)
    # whoever may choose among many shapes is the likelier to fit by chance
    scores = [replace(s, p=min(1.0, s.p * len(f))) for s, f in zip(scores, families, strict=True)]
    trials = {s.effect.name: len(f) for s, f in zip(scores, families, strict=True)}
    count = len(fitted.problem.nodes)
    ranked = sorted(scores, key=lambda s: _evidence(s, trials[s.effect.name], count), reverse=True)
    candidates: list[Candidate] = []
    still = hardly_turns(fitted)
    refits, leader = 0, -np.inf
    for score in ranked:
        refused = _objection(score)
        refused = refused or _steered(fitted, score, still=still)
        weight = _evidence(score, trials[score.effect.name], count)
        if refused or refits == _SHORTLIST or weight < _WORTH_A_REFIT * leader:
            candidates.append(Candidate(score, refused=refused or "others explain it better"))
            continue
        refits += 1
        candidates.append(_refitted(fitted, score, trials[score.effect.name], free_clocks))
        if not candidates[-1].refused:
            # one that cannot be had stands in nobody's way
            leader = max(leader, weight)
    return sorted(candidates, key=_rank, reverse=True)


def _evidence(score: Score, trials: int, count: int) -> float:
    return 0.5 * score.statistic / score.inflation - price(score.effect, trials, count)


def price(effect: Effect, trials: int, count: int) -> float:
    """Return the nats an effect must gain: (k/2) ln K for its parameters, and what looking about gains by chance."""
    return 0.5 * len(parameters(effect)) * float(np.log(count)) + float(np.log(trials))


def _objection(score: Score) -> str:
    """Return why an effect is out of question, or nothing."""
    if not score.separable:
        return "cannot be told from what is in the model"
    for p, value, error in zip(amplitudes(score.effect), score.estimate, score.standard_error, strict=True):
        room = p.high if value > 0.0 else -p.low
        if error * _KNOWN > 0.5 * max(p.high, -p.low):
            return "not testable on this drive"
        if abs(value) > room:
            why = "beyond what is physically possible" if room > 0.0 else "of a sign that it cannot have"
            return f"{p.name} would be {value:.3g}, {why}"
    if score.p >= LEVEL:
        return "no evidence"
    if score.held_out_nats <= score.held_out_error:
        return "does not gain on held-out blocks"
    return ""


def _steered(fitted: Fit, score: Score, *, still: bool) -> str:
    """Return why an effect may be the driver's work, or nothing."""
    columns = fitted.problem.columns(score.effect)
    answers = is_gain_of_turns(fitted, columns) and may_be_steering(fitted, columns, score.estimate)
    if answers or (still and acts_in_curves_only(fitted, score.effect)):
        return "turns no larger than the noise: it may be a driver who steers back"
    return ""


def _refitted(fitted: Fit, score: Score, trials: int, free_clocks: Sequence[tuple[bool, bool]]) -> Candidate:
    problem = fitted.problem
    values = {
        p.name: float(np.clip(v, p.low, p.high)) for p, v in zip(amplitudes(score.effect), score.estimate, strict=True)
    }
    moved = replace(score.effect, **values)  # type: ignore[type-var]  # effects are dataclasses
    worth = price(score.effect, trials, len(problem.nodes))

    def refit(free: Sequence[tuple[bool, bool]] | None) -> Fit:
        return fit(
            problem.recordings,
            (*problem.effects, moved),
            clocks=problem.clocks,
            free_clocks=free,
            approach=problem.approach,
            start=fitted.noise.free,
            weights=fitted.noise.weights,
            random=fitted.random,
        )

    again = refit(free_clocks)
    gain = again.log_likelihood - fitted.log_likelihood - worth
    if gain <= 0.0 and np.any(free_clocks):
        # between two stamps odometry is smoother: where the clock had strayed there, coming back looks like a loss
        gain = refit(None).log_likelihood - fitted.log_likelihood - worth
    before, after = drift(fitted), drift(again)
    refused = ""
    if gain <= 0.0:
        refused = "gains nothing when everything is fitted together"
    elif after.worse_than(before):
        refused = _SPOILS
    return Candidate(score, again, gain, (before.rmse, after.rmse), refused)

"""Candidates: library effects tested beside a model, with the reason why each was included or refused."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.errors import EffectError
from odomcorrupt.study.select.dictionary import first_order_bounds
from odomcorrupt.study.select.score import score_terms

if TYPE_CHECKING:
    from collections.abc import Iterable

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.score import Score
    from odomcorrupt.study.terms.term import LibraryTerm

_IMPOSSIBLE_SIGN = "of a physically impossible sign"
"""Refusal of an effect whose estimate has a physically impossible sign."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Candidate:
    """A library effect tested beside a model.

    score : its score test
    fitted : the effect as it was fitted with the model; None if it is not in it
    gain : held-out gain minus the cost of the term, nats
    rmse : 10 s position error of the fitted data without and with the term, m; NaN if it is not in the model
    refused : reason for the refusal; "" if it is in the model, or may be in it in place of another one
    """

    score: Score
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
        clear = self.score.robust_nats > decisions.replacement_nats
        return clear and _IMPOSSIBLE_SIGN in self.refused and self.name not in decisions.commanded


def drop_term(fit: Fit, effect: Effect) -> Fit:
    """Return the fit without one of its effects: its contribution is back in the residual, its columns are removed.

    To first order and with unchanged noise, for tests of replacements.
    """
    explained = fit.noise.whitener.whiten(fit.problem.explained(effect))
    noise = replace(fit.noise, innovations=fit.noise.innovations + explained)
    others = tuple(e for e in fit.effects if e is not effect)
    return replace(fit, noise=noise, problem=replace(fit.problem, effects=others, left=()))


def tested_candidates(fit: Fit, terms: Iterable[LibraryTerm], decisions: Decisions) -> list[Candidate]:
    """Return the tests of library effects that a fit lacks, each in the shape with the largest gain, the best first."""
    have, possible = {effect.name for effect in fit.effects}, []
    for term in terms:
        if term.name in have:
            continue
        try:
            possible.append((term, term.columns(fit.problem)))
        except EffectError:  # it acts on single wheels, and the track is unknown
            continue
    names = len({term.name for term, _ in possible})
    scores = score_terms(
        fit, [term for term, _ in possible], decisions, family=names, columns=[columns for _, columns in possible]
    )
    best: dict[str, Score] = {}
    for score in scores:
        if score.term.name not in best or score.nats > best[score.term.name].nats:
            best[score.term.name] = score
    found = [Candidate(score=score, refused=objection(fit, score, decisions)) for score in best.values()]
    return sorted(found, key=lambda one: -one.score.robust_nats)


def objection(fit: Fit, score: Score, decisions: Decisions) -> str:
    """Return why the selection did not include an effect."""
    if not score.separable:
        return "not separable from what is in the model"
    for p, error in zip(amplitudes(score.effect), score.standard_error, strict=True):
        if max(np.abs(first_order_bounds(fit, score.effect, p))) < 2.0 * error * decisions.testable_errors:
            return "not testable on this drive"
    if not score.significant(decisions.level):
        return "no evidence" if score.p >= decisions.level else "does not gain on held-out blocks"
    for p, value in zip(amplitudes(score.effect), score.estimate, strict=True):
        low, high = first_order_bounds(fit, score.effect, p)
        if not low <= value <= high:
            room = high if value > 0.0 else -low
            why = "beyond what is physically possible" if room > 0.0 else _IMPOSSIBLE_SIGN
            return f"{p.name} would be {f'{value:.3g} {p.unit}'.rstrip()}, {why}"
    return "others explain it better"

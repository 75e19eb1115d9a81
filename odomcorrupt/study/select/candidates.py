"""Candidates: library effects tested beside a model, with the reason why each was included or refused."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.select.dictionary import ClockChoice, ClockTerm, linearised
from odomcorrupt.study.select.score import scores_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.dictionary import Dictionary
    from odomcorrupt.study.select.score import Score
    from odomcorrupt.study.terms.term import BasisTerm, LibraryTerm

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

    @property
    def evidence(self) -> float:
        """Gain beside the model that has it, or that it was tested beside, nats."""
        return self.score.nats if self.fitted is None else self.gain

    def contradicts_physics(self, decisions: Decisions) -> bool:
        """Return whether the data support the effect only with a physically impossible sign, so have another flaw.

        Tyres do not slip inwards, and no response precedes its cause. Effects of commanded or lost motion are excepted,
        because their opposite is possible: instead of losing counts above a speed, a drive may saturate or slip there.
        """
        clear = self.score.nats > decisions.replacement_nats
        return clear and _IMPOSSIBLE_SIGN in self.refused and self.name not in decisions.commanded


def drop_term(fit: Fit, effect: Effect) -> Fit:
    """Return the fit without one of its effects: its contribution is back in the residual, its columns are removed.

    To first order and with unchanged noise, for tests of replacements.
    """
    explained = fit.noise.whitener.whiten(fit.problem.explained(effect))
    noise = replace(fit.noise, innovations=fit.noise.innovations + explained)
    others = tuple(e for e in fit.effects if e is not effect)
    return replace(fit, noise=noise, problem=replace(fit.problem, effects=others, left=()))


def score_terms(fit: Fit, terms: Sequence[LibraryTerm | BasisTerm], dictionary: Dictionary) -> list[Score]:
    """Return the score tests of terms, each beside the model of a fit; none for terms that cannot act."""
    if not terms:
        return []
    none = np.zeros((len(fit.free_clocks), 2))
    used, evidence = linearised(fit, (), terms, ClockChoice(none > 0.0, none), dictionary)
    own = [term for term in used if not isinstance(term, ClockTerm)]
    return scores_of(evidence, own) if own else []


def tested_candidates(fit: Fit, terms: Iterable[LibraryTerm], dictionary: Dictionary) -> list[Candidate]:
    """Return the tests of library effects that a fit lacks, each in the shape with the largest gain, the best first."""
    have = {effect.name for effect in fit.effects}
    scores = score_terms(fit, [term for term in terms if term.name not in have], dictionary)
    best: dict[str, Score] = {}
    for score in sorted(scores, key=lambda one: -one.nats):
        best.setdefault(score.term.name, score)
    return [Candidate(score=score, refused=objection(fit, score, dictionary)) for score in best.values()]


def objection(fit: Fit, score: Score, dictionary: Dictionary) -> str:
    """Return why the selection did not include an effect."""
    if not score.separable:
        return "not separable from what is in the model"
    bounds, decisions = dictionary.bounds_of(score.effect, fit), dictionary.decisions
    if np.any(np.abs(bounds).max(axis=1) < 2.0 * score.standard_error * decisions.testable_errors):
        return "not testable on this drive"
    if score.held_out_nats <= 0.0 or score.p >= decisions.level:
        return "no evidence"
    if score.held_out_nats <= score.held_out_error:
        return "does not gain on held-out blocks"
    for p, value, (low, high) in zip(amplitudes(score.effect), score.estimate, bounds.tolist(), strict=True):
        if not low <= value <= high:
            room = high if value > 0.0 else -low
            why = "beyond what is physically possible" if room > 0.0 else _IMPOSSIBLE_SIGN
            return f"{p.name} would be {f'{value:.3g} {p.unit}'.rstrip()}, {why}"
    return "others explain it better"

"""Tests beside a model: library effects, why each was included or refused, and dependences on one regressor.

A dependence is an error that no library effect explains. A basis function of one or two coefficients has more power
than a curve of eight, and can be in a model. The curve over the regressor (speed, yaw rate, ...) is reported: the error
per metre, radian turned, or second, as a few hat functions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.effects.expression import CHANNELS
from odomcorrupt.study.estimate.drive_type import is_holonomic
from odomcorrupt.study.estimate.problem import by_column
from odomcorrupt.study.io.recording import shared_frame
from odomcorrupt.study.select.dictionary import ClockChoice, ClockTerm, linearised
from odomcorrupt.study.select.evidence import project_out, scores_of
from odomcorrupt.study.terms.basis import curve_regressors

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.decisions import Decisions
    from odomcorrupt.study.select.dictionary import Dictionary
    from odomcorrupt.study.select.evidence import Score
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


_LEAST = 0.01
"""Fraction of the motion that a hat function of a curve has to cover."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Dependence:
    """An error of one channel that depends on one regressor.

    centres : (m,) values of the regressor, or (m, 2) places
    curve, curve_error : (m,) truth minus odometry per `per` at the centres (m/m, rad/m, rad/rad, rad/s), and its error
    nats : gain in log likelihood minus the penalty
    term, score : the basis function with the largest gain and its action, and its score test
    instead_of : names of the included effects that it may replace; empty if none

    Equality is identity of objects.
    """

    centres: Array
    curve: Array
    curve_error: Array
    nats: float
    term: BasisTerm
    score: Score
    instead_of: tuple[str, ...] = ()

    @property
    def channel(self) -> str:
        """Channel of the error."""
        return self.term.action.channel

    @property
    def regressor(self) -> str:
        """Regressor that the error depends on."""
        return self.term.function.regressor

    @property
    def per(self) -> str:
        """Unit of motion to which the error refers: "m" driven, "rad" turned, or "s"."""
        return self.term.action.per

    @property
    def expression(self) -> str:
        """An effect of that shape, for the user to edit."""
        return self.term.expression(self.score.estimate.tolist())

    @property
    def name(self) -> str:
        """Name of its effect in a model."""
        return self.term.name

    @property
    def title(self) -> str:
        """Channel and regressor, as in "yaw over speed"."""
        return f"{self.channel} over {self.regressor}"

    @property
    def wheels(self) -> str:
        """Wheels with the error if the term acts on wheels: "left", "right" or "wheels"; else ""."""
        return self.term.action.target if self.term.action.by_wheel else ""

    @property
    def place(self) -> str:
        """Location of the error in words, as in "within 2 m of (1.0, -0.5)"; "" if it is not confined to a place."""
        return self.term.function.place


def dependence_of(fit: Fit, term: BasisTerm, nats: float, dictionary: Dictionary) -> Dependence:
    """Return a basis function as a dependence, with the curve of its regressor and channel, scored beside a fit.

    fit : a model without the function
    nats : its gain minus its cost
    """
    (score,) = score_terms(fit, [term], dictionary)
    one = np.zeros(1), score.estimate[:1], score.standard_error[:1]
    centres, values, errors = _curve(fit, term, score.inflation) or one
    return Dependence(centres=centres, curve=values, curve_error=errors, nats=nats, term=term, score=score)


def _curve(fit: Fit, term: BasisTerm, inflation: float) -> tuple[Array, Array, Array] | None:
    """Return centres, coefficients and errors of the hats that describe a dependence; None with fewer than two."""
    motions, recordings = fit.problem.motions, fit.problem.recordings
    amount = np.concatenate(
        [{"m": np.hypot(m.v, m.vy), "rad": m.omega, "s": np.ones(len(m))}[term.action.per] * m.dt_s for m in motions]
    )
    regressors = curve_regressors(
        motions, placed=shared_frame(recordings) is not None, sideways=is_holonomic(recordings, motions)
    )
    if term.function.regressor not in regressors:
        return None
    regressor = regressors[term.function.regressor]
    parts = [regressor(motion) for motion in motions]
    hats = np.concatenate([values for values, _ in parts])
    used = np.abs(hats * amount[:, None]).sum(axis=0) > _LEAST * np.abs(amount).sum()
    if used.sum() < 2:
        return None
    unit = np.eye(3)[CHANNELS.index(term.action.channel)]
    columns = [fit.problem.intervals.column(np.outer(-hat * amount, unit)) for hat in hats.T[used]]
    rest = project_out(fit)
    white = rest.of(fit.noise.whitener.whiten(by_column(np.stack(columns))))
    covariance = np.linalg.pinv(white.T @ white, hermitian=True)
    errors = np.sqrt(np.diag(covariance) * inflation)
    return parts[0][1][used], covariance @ (white.T @ rest.residual), errors

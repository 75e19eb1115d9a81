"""Confidence of findings, and coefficients of a fitted dependence: the same in the terminal, the report and JSON."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.study.select.confidence import Evidence, confidence, evidence_of, noise_evidence

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from odomcorrupt.study.estimate.clocks import Clocks
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.dependence import Dependence
    from odomcorrupt.study.select.random_effects import RandomCoefficient
    from odomcorrupt.study.select.stepwise import Learned, Step

__all__ = [
    "ClockFound",
    "LawNumber",
    "clocks_found",
    "confidence_words",
    "fitted_expression",
    "law_numbers",
    "noise_confidence",
    "step_confidence",
]

_CLOCKS = ("time_offset", "clock_skew")
_LIKE_PLAY_S = 0.015
"""An offset as small as this may be the time in which a wheel's play is crossed: 5 mm at 0.3 to 0.5 m/s."""
_REAL = 3.9
"""Standard errors from which on a clock is off, and has not only been left free."""


class ClockFound(NamedTuple):
    """A clock that is off: as which effect, of which recording, its value, its standard error and confidence."""

    name: str
    recording: int
    value: float
    error: float
    sure: float


class LawNumber(NamedTuple):
    """A number of a law, with its standard error and unit."""

    value: float
    error: float
    unit: str


def clocks_found(clocks: Clocks) -> Iterator[ClockFound]:
    """Yield what is really there: a skew makes an offset free, too, which need not be."""
    for position, name in enumerate(_CLOCKS):
        for i, (clock, free, errors) in enumerate(zip(clocks.clocks, clocks.free, clocks.errors, strict=True)):
            value, error = (clock.offset_s, clock.rate)[position], errors[position]
            if free[position] and abs(value) > _REAL * error:
                own = 0.5 * (value / error) ** 2
                # what could not be tried, play in gears of which no track is known, may do as much
                alike = (own,) if clocks.untested and name == "time_offset" and abs(value) < _LIKE_PLAY_S else ()
                rivals = tuple(min(nats, own) for nats in clocks.rival_nats) if name == "time_offset" else ()
                sure = confidence(Evidence(own, (*alike, *rivals)))
                yield ClockFound(name, i, float(value), float(error), sure)


def step_confidence(step: Step, learned: Learned) -> float:
    """Return the confidence in the name of the effect that a step added."""
    return confidence(evidence_of(step, learned))


def noise_confidence(gain: RandomCoefficient, learned: Learned) -> float:
    """Return the confidence in the name of a random effect."""
    return confidence(noise_evidence(gain, learned))


def confidence_words(sure: float) -> str:
    """Return "confidence 0.99", rounded down: 0.999 is not certain."""
    return f"confidence {int(100.0 * sure) / 100.0:.2f}"


def law_numbers(unknown: Dependence, learned: Learned, fit: Fit | None = None) -> dict[str, LawNumber]:
    """Return the coefficients of a fitted dependence by name, from the final fit; none for one that is not fitted.

    fit : the fit that is reported, where it is not the search's own
    """
    fit = fit or learned.fit
    if unknown not in learned.laws or unknown.best is None:
        return {}
    errors = iter(fit.standard_errors)
    for effect in fit.effects:
        own = [LawNumber(getattr(effect, p.name), float(next(errors)), p.unit) for p in amplitudes(effect)]
        if effect.name == unknown.name:
            return {p.name: number for p, number in zip(amplitudes(effect), own, strict=True)}
    return {}


def fitted_expression(unknown: Dependence, numbers: Mapping[str, LawNumber]) -> str:
    """Return the expression of an unknown dependence: with these coefficients, where it is fitted."""
    if unknown.best is None or not numbers:
        return unknown.expression
    return unknown.best.term.expression([number.value for number in numbers.values()])

"""Numbers of findings in words: values with errors in common units, confidences, clocks and fitted dependences."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.effects.effect import Effect, amplitudes, choices, parameters
from odomcorrupt.effects.region_slip import RegionSlip
from odomcorrupt.study.select.confidence import Evidence, confidence, evidence_of, noise_evidence

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from odomcorrupt.study.estimate.clocks import Clocks
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.returns import ReturnsFit
    from odomcorrupt.study.select.dependence import Dependence
    from odomcorrupt.study.select.random_effects import DetectedRandomEffect
    from odomcorrupt.study.select.stepwise import Learned, Step


def effects_with_errors(fit: Fit | ReturnsFit) -> list[tuple[Effect, list[float]]]:
    """Return the effects of a fit, each with the standard errors of its amplitudes."""
    errors = iter(fit.standard_errors)
    return [(effect, [float(next(errors)) for _ in amplitudes(effect)]) for effect in fit.effects]


_COMMON = {"m": (1e3, "mm"), "s": (1e3, "ms"), "": (1e2, "%")}


def value_text(value: float, error: float | None, unit: str) -> str:
    """Return a value with its error in common units."""
    scale, shown = _COMMON.get(unit, (1.0, unit))
    if unit.startswith("rad"):
        scale, shown = degrees(1.0), "deg" + unit[3:]
    elif unit == "s" and abs(value) >= 1.0:
        scale, shown = 1.0, unit
    return f"{value * scale:.4g}{'' if error is None else f' +- {error * scale:.2g}'} {shown}"


def numbers_text(effect: Effect, errors: Sequence[float]) -> list[str]:
    """Return an effect's numbers in words: amplitudes with their errors, then its shape, positions in metres."""
    own = amplitudes(effect)
    shown = zip(own, errors, strict=True)
    sizes = [f"{p.name} {value_text(getattr(effect, p.name), error, p.unit)}" for p, error in shown]
    shapes = [p for p in parameters(effect) if not p.amplitude]
    extent = _extent(effect)
    shapes = [p for p in shapes if not (extent and p.name in ("radius", "width"))]
    return [*sizes, *(f"{p.name} {_shape_text(getattr(effect, p.name), p.unit)}" for p in shapes), *extent]


def _extent(effect: Effect) -> list[str]:
    """Return the full size of a region in words; its parameters are half sizes."""
    if not isinstance(effect, RegionSlip):
        return []
    if not effect.width:
        return [f"diameter {2.0 * effect.radius:.2g} m"]
    return [f"{2.0 * effect.radius:.1f} m x {2.0 * effect.width:.1f} m"]


def noise_text(effect: Effect) -> list[str]:
    """Return a random effect's numbers and the wheel it acts on, in words; a time constant of zero is left out."""
    shown = [p for p in parameters(effect) if p.amplitude or getattr(effect, p.name)]
    wheel = getattr(effect, "wheel", "both")
    return [
        *([f"wheel {wheel}"] if wheel != "both" else []),
        *(f"{p.name} {value_text(getattr(effect, p.name), None, p.unit)}" for p in shown),
    ]


def _shape_text(value: float, unit: str) -> str:
    """Return a shape parameter in words; positions are given to the millimetre, however large their coordinates."""
    return f"{round(value, 3):.10g} m" if unit == "m" else value_text(value, None, unit)


def clock_lines(names: Sequence[str], clocks: Clocks) -> list[str]:
    """Return a line for every recording with a clock error, with its confidence."""
    parts: dict[int, list[str]] = {}
    for one in clocks_found(clocks):
        said = f"{one.name.rpartition('_')[2]} {one.text} ({confidence_words(one.confidence)})"
        parts.setdefault(one.recording, []).append(said)
    return [f"{names[i]}: the odometry's clock is off: {', '.join(parts[i])}" for i in sorted(parts)]


def words_text(effect: Effect) -> str:
    """Return an effect's word-valued parameters that differ from the default, as " (heading gyro)", or ""."""
    said = [
        f"{word} {getattr(effect, word)}"
        for word, (usual, *_) in choices(effect).items()
        if getattr(effect, word) != usual
    ]
    return f" ({', '.join(said)})" if said else ""


_CLOCKS = ("time_offset", "clock_skew")
SIGNIFICANT = 3.9
"""Standard errors from which a clock error counts as significant; others were only estimated."""


class ClockFound(NamedTuple):
    """A significant clock error: its effect, recording, value, standard error and confidence."""

    name: str
    recording: int
    value: float
    error: float
    confidence: float

    @property
    def text(self) -> str:
        """Value and standard error: ms of an offset, ppm of a skew."""
        if self.name == "time_offset":
            return value_text(self.value, self.error, "s")
        return f"{self.value * 1e6:.0f} +- {self.error * 1e6:.2g} ppm"


class LawNumber(NamedTuple):
    """A coefficient of a law, with its standard error and unit."""

    value: float
    error: float
    unit: str


def clocks_found(clocks: Clocks) -> Iterator[ClockFound]:
    """Yield the significant clock errors: a skew also makes an offset free, which need not be significant."""
    for position, name in enumerate(_CLOCKS):
        for i, (clock, free, errors) in enumerate(zip(clocks.clocks, clocks.free, clocks.errors, strict=True)):
            value, error = (clock.offset_s, clock.rate)[position], errors[position]
            if free[position] and abs(value) > SIGNIFICANT * error:
                own = 0.5 * (value / error) ** 2
                margins, left = (clocks.margins_nats, clocks.left_nats) if name == "time_offset" else ((), 0.0)
                probability = confidence(Evidence(own, tuple(own - max(nats, 0.0) for nats in margins), left))
                yield ClockFound(name, i, float(value), float(error), probability)


def step_confidence(step: Step, learned: Learned) -> float:
    """Return the confidence in the name of the effect added by a step."""
    return confidence(evidence_of(step, learned))


def noise_confidence(gain: DetectedRandomEffect, learned: Learned) -> float:
    """Return the confidence in the name of a random effect."""
    return confidence(noise_evidence(gain, learned))


def confidence_words(probability: float) -> str:
    """Return "confidence 0.99", rounded down: 0.999 is not certain."""
    return f"confidence {int(100.0 * probability) / 100.0:.2f}"


def law_numbers(unknown: Dependence, learned: Learned, fit: Fit | None = None) -> dict[str, LawNumber]:
    """Return the coefficients of a fitted dependence by name, from the final fit; none for one that is not fitted.

    fit : the reported fit, if it is not that of the search
    """
    fit = fit or learned.fit
    if unknown not in learned.laws or unknown.best is None:
        return {}
    for effect, errors in effects_with_errors(fit):
        if effect.name == unknown.name:
            own = zip(amplitudes(effect), errors, strict=True)
            return {p.name: LawNumber(getattr(effect, p.name), error, p.unit) for p, error in own}
    return {}


def fitted_expression(unknown: Dependence, numbers: Mapping[str, LawNumber]) -> str:
    """Return the expression of a dependence, with these coefficients if it was fitted."""
    if unknown.best is None or not numbers:
        return unknown.expression
    return unknown.best.term.expression([number.value for number in numbers.values()])

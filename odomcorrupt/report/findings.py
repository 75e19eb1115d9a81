"""Findings of a search, prepared once for text, JSON, HTML and figures, and their numbers in words."""

from __future__ import annotations

from math import degrees, exp
from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.effects.effect import Effect, amplitudes, choices, parameters
from odomcorrupt.effects.ground import RegionSlip
from odomcorrupt.study.estimate.drive_type import readings_of
from odomcorrupt.study.estimate.random_process import part_name
from odomcorrupt.study.select.confidence import Support, confidence, may_be_scale_of_truth, noise_support, support_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from odomcorrupt.study.estimate.clocks import Clocks
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.returns import ReturnsFit
    from odomcorrupt.study.select.dependence import Dependence
    from odomcorrupt.study.select.result import Learned, Step
    from odomcorrupt.study.validate.compare import ModelEvaluation


SIGNIFICANT = 3.9
"""Standard errors from which a clock error or a mounting counts as significant; others were only estimated."""


def effects_with_errors(fit: Fit | ReturnsFit) -> list[tuple[Effect, list[float]]]:
    """Return the effects of a fit, each with the standard errors of its amplitudes."""
    errors = iter(fit.standard_errors)
    return [(effect, [float(next(errors)) for _ in amplitudes(effect)]) for effect in fit.effects]


class FoundEffect(NamedTuple):
    """An effect that a step of the search added.

    errors : standard errors of its amplitudes
    aliases : second names of the same error, which no recording can separate
    rivals : names of other effects that explain these data as well
    confidence : probability of its name
    negligible : whether it is significant, but too small to matter
    """

    effect: Effect
    errors: list[float]
    step: Step
    aliases: tuple[str, ...]
    rivals: tuple[str, ...]
    confidence: float
    negligible: bool

    @property
    def names(self) -> str:
        """Name with its aliases."""
        return f"{self.effect.name} (= {', '.join(self.aliases)})" if self.aliases else self.effect.name

    @property
    def gain_nats(self) -> float:
        """Gain in log likelihood by the step, minus the penalty of its parameters."""
        return self.step.candidates[0].gain


def effects_found(learned: Learned, fit: Fit | None = None) -> list[FoundEffect]:
    """Return the added effects in the order of the search.

    fit : the reported fit, if it is not that of the search; effects that it lacks are left out
    """
    own, drive = {effect.name: (effect, errors) for effect, errors in effects_with_errors(fit or learned.fit)}, None
    found = []
    for step in learned.steps:
        if step.added is not None and step.added in own:
            drive = drive or learned.drive_type
            effect, errors = own[step.added]
            aliases = readings_of(effect, drive)
            rivals = tuple(name for name in step.alternatives if name not in aliases)
            probability, negligible = confidence(support_of(step, learned, fit)), learned.is_negligible(effect.name)
            found.append(FoundEffect(effect, errors, step, aliases, rivals, probability, negligible))
    return found


class FoundNoise(NamedTuple):
    """A random effect that was detected: its gain in nats, and the probability of its name.

    of_truth : whether a varying scale of the truth may cause it
    """

    effect: Effect
    nats: float
    confidence: float
    of_truth: bool

    @property
    def name(self) -> str:
        """Name with the channel that it acts on."""
        return part_name(self.effect)


def noise_found(learned: Learned) -> list[FoundNoise]:
    """Return the detected random effects."""
    return [
        FoundNoise(
            one.effect, one.nats, confidence(noise_support(one, learned)), bool(may_be_scale_of_truth(one, learned))
        )
        for one in learned.noise
    ]


_GROSS = 2.0
"""Factor between measured and predicted errors from which noise alone is no explanation."""


def is_unexplained(learned: Learned, last: ModelEvaluation | None, *, falls: bool = True) -> bool:
    """Return whether held-out data reject a model in which nothing that matters, or nothing but noise, was found.

    last : evaluation of the model with all findings, if there is one
    falls : whether the held-out error or likelihood improves with the findings
    """
    if learned.lacking or learned.unexplained or learned.hardly_errs:
        return False
    # errors smaller than the noise predicts need no further cause
    misfit = last.verdict.misfit if last is not None and last.verdict.fails else 1.0
    return not falls or misfit > _GROSS if learned.noise else misfit > 1.0


class LawNumber(NamedTuple):
    """A coefficient of a law, with its standard error and unit."""

    value: float
    error: float
    unit: str


class FoundDependence(NamedTuple):
    """A dependence that no library effect explains, or that may replace one.

    numbers : coefficients by name, if it was fitted
    fitted : whether it is in the model as a basis function
    left_out : why it was left out of the model, if it was
    """

    law: Dependence
    numbers: dict[str, LawNumber]
    fitted: bool
    left_out: str = ""

    @property
    def part(self) -> str:
        """Name of its effect in the model, "" if it is not in it."""
        return self.law.name if self.fitted else ""

    @property
    def expression(self) -> str:
        """Expression of the dependence, with its coefficients if it was fitted."""
        if not self.numbers:
            return self.law.expression
        return self.law.term.expression([number.value for number in self.numbers.values()])


def dependences_found(learned: Learned, fit: Fit | None = None) -> list[FoundDependence]:
    """Return the dependences that the search found, those with the most evidence first.

    fit : the reported fit, if it is not that of the search
    """
    own = {effect.name: (effect, errors) for effect, errors in effects_with_errors(fit or learned.fit)}
    found = []
    for law in learned.unknown:
        numbers = {}
        if law in learned.laws and law.name in own:
            effect, errors = own[law.name]
            pairs = zip(amplitudes(effect), errors, strict=True)
            numbers = {p.name: LawNumber(getattr(effect, p.name), error, p.unit) for p, error in pairs}
        fitted = law in learned.laws
        found.append(FoundDependence(law, numbers, fitted, learned.why_left_out(law)))
    return found


def foremost(found: Sequence[FoundDependence], most: int) -> list[FoundDependence]:
    """Return all dependences of the model, and those with the most evidence among others, together `most` if possible.

    found : in the order of their evidence, see `dependences_found`
    """
    others = most - sum(one.fitted for one in found)
    chosen = []
    for one in found:
        if one.fitted or others > 0:
            chosen.append(one)
            others -= not one.fitted
    return chosen


_CLOCKS = ("time_offset", "clock_skew")


class ClockFound(NamedTuple):
    """A significant clock error: its effect, recording, value, standard error and confidence."""

    name: str
    recording: int
    value: float
    error: float
    confidence: float


def clocks_found(clocks: Clocks) -> Iterator[ClockFound]:
    """Yield the significant clock errors: a skew also makes an offset free, which need not be significant."""
    for position, name in enumerate(_CLOCKS):
        for i, (clock, free, errors) in enumerate(zip(clocks.clocks, clocks.free, clocks.errors, strict=True)):
            value, error = (clock.offset_s, clock.rate)[position], errors[position]
            if free[position] and abs(value) > SIGNIFICANT * error:
                own = 0.5 * (value / error) ** 2
                margins, left = (clocks.margins_nats, clocks.left_nats) if name == "time_offset" else ((), 0.0)
                probability = confidence(Support(own, sum(exp(-max(nats, 0.0)) for nats in margins), left=left))
                yield ClockFound(name, i, float(value), float(error), probability)


_COMMON = {"m": (1e3, "mm"), "s": (1e3, "ms"), "": (1e2, "%")}


def plainly(value: float) -> str:
    """Return a number to two digits, without an exponent: "170"."""
    return f"{float(f'{value:.2g}'):g}"


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
    extent = []
    if isinstance(effect, RegionSlip):
        # the full size; the parameters are half sizes
        shapes = [p for p in shapes if p.name not in ("radius", "width")]
        sides = f"{2.0 * effect.radius:.1f} m x {2.0 * effect.width:.1f} m"
        extent = [sides if effect.width else f"diameter {2.0 * effect.radius:.2g} m"]
    return [*sizes, *(f"{p.name} {_shape_text(getattr(effect, p.name), p.unit)}" for p in shapes), *extent]


def noise_text(effect: Effect) -> list[str]:
    """Return a random effect's numbers and the wheel it acts on, in words; a time constant of zero is left out."""
    shown = [p for p in parameters(effect) if p.amplitude or getattr(effect, p.name)]
    wheel = getattr(effect, "wheel", "both")
    # a difference between the gains of the wheels is a turn for each metre of travel
    gain = "rad/m" if getattr(effect, "channel", "") == "wheels" else ""
    return [
        *([f"wheel {wheel}"] if wheel != "both" else []),
        *(f"{p.name} {value_text(getattr(effect, p.name), None, p.unit or gain)}" for p in shown),
    ]


def _shape_text(value: float, unit: str) -> str:
    """Return a shape parameter in words; positions are given to the millimetre, however large their coordinates."""
    return f"{round(value, 3):.10g} m" if unit == "m" else value_text(value, None, unit)


def clock_lines(names: Sequence[str], clocks: Clocks) -> list[str]:
    """Return a line for every recording with a clock error, with its confidence."""
    parts: dict[int, list[str]] = {}
    for one in clocks_found(clocks):
        said = f"{one.name.rpartition('_')[2]} {clock_text(one)} ({confidence_words(one.confidence)})"
        parts.setdefault(one.recording, []).append(said)
    return [f"{names[i]}: the odometry's clock is off: {', '.join(parts[i])}" for i in sorted(parts)]


def clock_text(one: ClockFound) -> str:
    """Return the value and standard error of a clock error: ms of an offset, ppm of a skew."""
    if one.name == "time_offset":
        return value_text(one.value, one.error, "s")
    return f"{one.value * 1e6:.0f} +- {one.error * 1e6:.2g} ppm"


def words_text(effect: Effect) -> str:
    """Return an effect's word-valued parameters that differ from the default, as " (heading gyro)", or ""."""
    said = [
        f"{word} {getattr(effect, word)}"
        for word, (usual, *_) in choices(effect).items()
        if getattr(effect, word) != usual
    ]
    return f" ({', '.join(said)})" if said else ""


def confidence_words(probability: float) -> str:
    """Return "confidence 0.99", rounded down, as 0.999 is not certain; or "confidence below 0.01"."""
    return "confidence below 0.01" if probability < 0.01 else f"confidence {int(100.0 * probability) / 100.0:.2f}"

"""Findings of a search, prepared once for text, JSON, HTML and figures: effects, noise, dependences and clocks."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.effects.effect import Effect, amplitudes
from odomcorrupt.study.estimate.drive_type import readings_of
from odomcorrupt.study.estimate.random_process import part_name
from odomcorrupt.study.select.confidence import (
    Evidence,
    confidence,
    evidence_of,
    may_be_scale_of_truth,
    noise_evidence,
)

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
            probability, negligible = confidence(evidence_of(step, learned)), learned.is_negligible(effect.name)
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
            one.effect, one.nats, confidence(noise_evidence(one, learned)), bool(may_be_scale_of_truth(one, learned))
        )
        for one in learned.noise
    ]


_GROSS = 2.0
"""Factor between measured and predicted errors from which noise alone is no explanation."""


def is_unexplained(learned: Learned, last: ModelEvaluation | None, *, falls: bool = True) -> bool:
    """Return whether held-out data reject a model in which nothing, or nothing but noise, was found.

    last : evaluation of the model with all findings, if there is one
    falls : whether the held-out error or likelihood improves with the findings
    """
    if learned.lacking or learned.laws:
        return False
    if not learned.noise:
        return last is not None and last.verdict.fails
    misfit = last.verdict.misfit if last is not None and last.verdict.fails else 1.0
    return not falls or not 1.0 / _GROSS <= misfit <= _GROSS


class LawNumber(NamedTuple):
    """A coefficient of a law, with its standard error and unit."""

    value: float
    error: float
    unit: str


class FoundDependence(NamedTuple):
    """A dependence that no library effect explains, or that may replace one.

    numbers : coefficients by name, if it was fitted
    fitted : whether it is in the model as a basis function
    mean : its mean, if only that is in the model
    left_out : why it was left out of the model, if it was
    """

    law: Dependence
    numbers: dict[str, LawNumber]
    fitted: bool
    mean: float | None
    left_out: str = ""

    @property
    def in_model(self) -> bool:
        """Whether it, or its mean, is in the model."""
        return self.fitted or self.mean is not None

    @property
    def part(self) -> str:
        """Name of the effect of the model that it, or its mean, is; "" if neither is in the model."""
        return self.law.name if self.fitted else f"mean_of_{self.law.name}" if self.mean is not None else ""

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
        found.append(FoundDependence(law, numbers, fitted, learned.mean_of(law), learned.why_left_out(law)))
    return found


def foremost(found: Sequence[FoundDependence], most: int) -> list[FoundDependence]:
    """Return all dependences of the model, and those with the most evidence among others, together `most` if possible.

    found : in the order of their evidence, see `dependences_found`
    """
    others = most - sum(one.in_model for one in found)
    chosen = []
    for one in found:
        if one.in_model or others > 0:
            chosen.append(one)
            others -= not one.in_model
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
                probability = confidence(Evidence(own, tuple(own - max(nats, 0.0) for nats in margins), left))
                yield ClockFound(name, i, float(value), float(error), probability)

"""A fit, findings and the next drive, prepared once for summary, text, JSON (schema 2 of docs/json.md), HTML, figures.

A summary has eight lines: verdict, sizes, held-out errors, what stays open, next command.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from math import degrees, exp, inf, isfinite, radians
from typing import TYPE_CHECKING, Any, NamedTuple

from odomcorrupt.effects import registry
from odomcorrupt.effects.effect import Effect, amplitudes, choices, parameters
from odomcorrupt.effects.ground import RegionSlip
from odomcorrupt.export import WHEEL_EFFECTS, wheel_multipliers
from odomcorrupt.report import comparison as comparisons
from odomcorrupt.report.comparison import reproduction_sentence, size
from odomcorrupt.report.plain import picked
from odomcorrupt.study.estimate.drive_type import readings_of
from odomcorrupt.study.estimate.outliers import Event, events, single_events
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE, part_name
from odomcorrupt.study.estimate.windows import distance_windows, joint_rmse
from odomcorrupt.study.select.confidence import EVEN_ODDS, Support, confidence, noise_support, support_of
from odomcorrupt.study.validate.compare import agreement_of
from odomcorrupt.study.validate.trajectory_error import clock_gain
from odomcorrupt.summary import ALWAYS, FIRST, FOUND, SPARE, USUAL, Line, Summary, Tone

if TYPE_CHECKING:
    from collections.abc import Callable, Container, Iterable, Iterator, Mapping, Sequence

    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.study.design.advise import Advice, Ambiguity, DetectionLimit
    from odomcorrupt.study.design.plan import Plan
    from odomcorrupt.study.estimate.calibrate import Interval, RobotFit
    from odomcorrupt.study.estimate.clocks import Clocks
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.returns import ReturnsFit
    from odomcorrupt.study.io.recording import Mistake
    from odomcorrupt.study.select.candidates import Candidate, Dependence
    from odomcorrupt.study.select.heterogeneity import ParameterDifference
    from odomcorrupt.study.select.result import Learned, Step
    from odomcorrupt.study.validate.compare import Comparison, ModelEvaluation
    from odomcorrupt.study.validate.predictive_check import Reproduction


SIGNIFICANT = 3.9
"""Standard errors from which a clock error or a mounting counts as significant; others were only estimated."""


def effects_with_errors(fit: Fit | ReturnsFit) -> list[tuple[Effect, list[float]]]:
    """Return the effects of a fit, each with the standard errors of its amplitudes."""
    errors = iter(fit.standard_errors)
    return [(effect, [float(next(errors)) for _ in amplitudes(effect)]) for effect in fit.effects]


class Found(NamedTuple):
    """A systematic or random effect that the search found: summary, text, JSON and HTML are made of it.

    errors : standard errors of its amplitudes; none of a random effect
    confidence : probability of its name
    nats : gain in log likelihood, minus the penalty of its parameters
    step : of the search that added it; None of a random effect
    aliases : second names of the same error, which no recording can separate
    rivals : names of other effects that explain these data as well
    negligible : whether it is significant, but too small to matter
    """

    effect: Effect
    errors: Sequence[float]
    confidence: float
    nats: float
    step: Step | None = None
    aliases: tuple[str, ...] = ()
    rivals: tuple[str, ...] = ()
    negligible: bool = False

    @property
    def names(self) -> str:
        """Name with its aliases, of a random effect with the channel that it acts on."""
        name = part_name(self.effect)
        return f"{name} (= {', '.join(self.aliases)})" if self.aliases else name

    @property
    def numbers(self) -> list[str]:
        """Its numbers, in words."""
        return noise_text(self.effect) if self.step is None else numbers_text(self.effect, self.errors)

    @property
    def probability(self) -> str:
        """Its confidence, in words."""
        return confidence_words(self.confidence)


def effects_found(learned: Learned, fit: Fit | None = None) -> list[Found]:
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
            probability, nats = confidence(support_of(step, learned, fit)), step.candidates[0].gain
            negligible = learned.is_negligible(effect.name)
            found.append(Found(effect, errors, probability, nats, step, aliases, rivals, negligible))
    return found


def noise_found(learned: Learned) -> list[Found]:
    """Return the detected random effects."""
    supports = ((one, confidence(noise_support(one, learned))) for one in learned.noise)
    return [Found(one.effect, (), probability, one.nats) for one, probability in supports]


GROSS = 2.0
"""Factor between measured and predicted errors from which noise alone is no explanation, and no cause the only one."""


def is_unexplained(learned: Learned, last: ModelEvaluation | None, *, falls: bool = True) -> bool:
    """Return whether held-out data reject a model without a likely cause, or travel could not be compared at all.

    last : evaluation of the model with all findings, if there is one
    falls : whether the held-out error or likelihood improves with the findings
    """
    sure = not are_doubtful(effects_found(learned))
    if all(one.positioned and "travel not comparable" in one.ratios for one in learned.fit.problem.recordings):
        return not (sure or learned.hardly_errs)
    named = learned.lacking and (sure or are_doubtful(noise_found(learned)))
    if learned.unexplained or learned.hardly_errs or named:
        return False
    # errors smaller than the noise predicts need no further cause
    misfit = last.verdict.misfit if last is not None and last.verdict.fails else 1.0
    return not falls or misfit > GROSS if learned.noise else misfit > 1.0


def are_doubtful(found: Iterable[Found]) -> bool:
    """Return whether none of the findings is likely to be a cause that matters."""
    return not any(one.confidence >= EVEN_ODDS and not one.negligible for one in found)


class FoundDependence(NamedTuple):
    """A dependence that no library effect explains, or that may replace one.

    numbers : coefficients by name, with standard error and unit, if it was fitted
    fitted : whether it is in the model as a basis function
    left_out : why it was left out of the model, if it was
    """

    law: Dependence
    numbers: dict[str, tuple[float, float, str]]
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
        return self.law.term.expression([value for value, _, _ in self.numbers.values()])


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
            numbers = {p.name: (getattr(effect, p.name), error, p.unit) for p, error in pairs}
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


class ClockFound(NamedTuple):
    """A significant clock error: its effect, recording, value, standard error and confidence."""

    name: str
    recording: int
    value: float
    error: float
    confidence: float


def clocks_found(clocks: Clocks) -> Iterator[ClockFound]:
    """Yield the significant clock errors: a skew also makes an offset free, which need not be significant."""
    for position, name in enumerate(("time_offset", "clock_skew")):
        for i, (clock, free, errors) in enumerate(zip(clocks.clocks, clocks.free, clocks.errors, strict=True)):
            value, error = (clock.offset_s, clock.rate)[position], errors[position]
            if free[position] and abs(value) > SIGNIFICANT * error:
                own = 0.5 * (value / error) ** 2
                margins, left = (clocks.margins_nats, clocks.left_nats) if name == "time_offset" else ((), 0.0)
                probability = confidence(Support(own, sum(exp(-max(nats, 0.0)) for nats in margins), left=left))
                yield ClockFound(name, i, float(value), float(error), probability)


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
    extent = []
    if isinstance(effect, RegionSlip):
        # the full size; the parameters are half sizes
        shapes = [p for p in shapes if p.name not in ("radius", "width")]
        sides = f"{2.0 * effect.radius:.1f} m x {2.0 * effect.width:.1f} m"
        extent = [sides if effect.width else f"diameter {2.0 * effect.radius:.2g} m"]
    # positions to the millimetre, however large their coordinates
    words = [
        f"{p.name} {f'{round(value, 3):.10g} m' if p.unit == 'm' else value_text(value, None, p.unit)}"
        for p in shapes
        for value in [getattr(effect, p.name)]
    ]
    return [*sizes, *words, *extent]


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


def advice_sentences(advice: Advice, instead: Mapping[str, str] | None = None) -> list[str]:
    """Return a sentence for every ambiguity, and one per group of effects with the same reason and drive.

    instead : effects with evidence of their own, each with the effect that was selected in its place
    """
    groups: dict[str, list[str]] = {}
    for one in advice.untestable:
        chosen = (instead or {}).get(one.effect)
        why = f"not separated from {chosen}" if chosen else f"not testable here: {one.why}"
        drive = f"drive {drive_sentence(one.plan)}" if one.plan is not None else one.hint
        groups.setdefault("; ".join(filter(None, (why, drive))), []).append(one.effect)
    return [*map(_choice_sentence, advice.choices), *(f"{', '.join(own)}: {why}" for why, own in groups.items())]


def _choice_sentence(choice: Ambiguity) -> str:
    """Return "A or B: these data do not separate them; drive X"."""
    names = " or ".join(choice.names)
    if choice.plan is None:
        if choice.hint:
            return f"{names}: identical on every drive: {choice.hint}"
        return f"{names}: these data do not separate them, and no drive of ten minutes would"
    why = f" ({choice.why})" if choice.why else ""
    return (
        f"{names}: these data do not separate them{why}; drive {drive_sentence(choice.plan)}: "
        f"that is expected to separate them by {choice.nats:.0f} nats"
    )


def inseparable_sentence(advice: Advice, readings: Callable[[str], Sequence[str]]) -> str:
    """Return "These data cannot separate A from B and C, nor D from E: drive X", of all ambiguities; "" without any.

    readings : aliases of a name, which no drive separates and which are therefore not reported as open
    """
    against: dict[str, list[str]] = {}
    for choice in advice.choices:
        name, *others = choice.names
        rivals = [other for other in others if other not in readings(name)]
        if rivals:
            against.setdefault(name, []).extend(rivals)
    if not against:
        return ""
    pairs = [f"{name} from {' or '.join(dict.fromkeys(others))}" for name, others in against.items()]
    resolvable = any(choice.plan is not None for choice in advice.choices if choice.names[0] in against)
    words = "; no drive of ten minutes would"
    if resolvable and advice.best is not None:  # the drive that resolves most ambiguities
        minutes = advice.best.duration_s / 60.0
        words = f": drive {advice.best.manoeuvre.sentence}, for {minutes:.0f} minutes"
    return f"These data cannot separate {', nor '.join(pairs)}{words}"


def drive_sentence(plan: Plan) -> str:
    """Return a drive's manoeuvre, duration, speed and floor area."""
    length, width = plan.floor_m
    moving = f"up to {plan.fastest_mps:.1f} m/s on {length + 1.0:.0f} m x {width + 1.0:.0f} m"
    if plan.fastest_mps == 0.0:
        moving = f"up to {degrees(abs(plan.omega_radps).max()):.0f} deg/s"
    return f"{plan.manoeuvre.sentence}, for {plan.duration_s / 60.0:.0f} minutes ({moving})"


def limits_sentence(limits: Sequence[DetectionLimit]) -> str:
    """Return the smallest detectable sizes in common units; "" if there are none."""
    every = [limit.effect for limit in limits]
    names = [one.effect if every.count(one.effect) == 1 else f"{one.effect} {one.parameter}" for one in limits]
    sizes = ", ".join(f"{name} {limit_size(limit)}" for name, limit in zip(names, limits, strict=True))
    return f"smallest detectable sizes: {sizes}" if limits else ""


def limit_size(limit: DetectionLimit) -> str:
    """Return a size with two figures in a common unit."""
    number, _, unit = value_text(limit.size, None, limit.unit).partition(" ")
    return f"{float(f'{float(number):.2g}'):g} {unit}".strip()


NOTHING = "nothing is missing: no known effect explains more than chance"


def found_text(
    learned: Learned, advice: Advice, *, evaluated: ModelEvaluation | None = None, fit: Fit | None = None
) -> str:
    """Return the findings in order of evidence, undecided alternatives, and the smallest detectable sizes.

    evaluated : evaluation of the final model, if available
    fit : fit of the final model, if it is not that of the search
    """
    lines = clock_lines([r.name for r in learned.fit.problem.recordings], learned.clocks)
    if learned.added:
        lines.append("missing, in the order of evidence, each added to those before:")
        lines += [_added_line(one, one.step) for one in effects_found(learned) if one.step is not None]
    for noise in noise_found(learned):
        said = f"{noise.names}, {', '.join(noise.numbers)} ({noise.probability})"
        lines.append(f"noise: {said}: {noise.effect.summary}")
    for unknown in foremost(dependences_found(learned, fit), 3):
        other = " and ".join(unknown.law.instead_of)
        lines.append(f"{f'or instead of {other}' if other else 'unknown'}: {evidence_words(unknown.law)}")
        spread = ", ".join(f"{name} {value_text(*number)}" for name, number in unknown.numbers.items())
        shown = f"{unknown.expression}{f'  ({spread})' if spread else ''}"
        lines.append(f"  {'fitted' if unknown.fitted else 'suggested'}: {shown}")
    lines += [_event_line(one) for one in single_events(learned.fit)]
    lines += [_disagreement_line(one, learned) for one in learned.disagreements]
    lines += [contradiction(one) for one in learned.contradicted]
    small = {name: learned.contributions[name].ten_seconds for name in learned.added if learned.is_negligible(name)}
    moved = [
        f"{name} moves {size('along', span.moved_m)} in 10 s, of {size('along', span.error_m)} that remains"
        for name, span in small.items()
    ]
    lines += [f"negligible, though significant: {', '.join(moved)}"] if moved else []
    if evaluated is not None and evaluated.verdict.fails:
        lines.append(unnamed(comparisons.rejection(evaluated), found=bool(lines)))
    elif evaluated is not None and evaluated.verdict.rejected:
        lines.append(f"the model holds in practice: {comparisons.within(evaluated)}")
    lines = lines or [NOTHING]
    lines += [*advice_sentences(advice, selected_instead(learned)), *filter(None, [limits_sentence(advice.limits)])]
    return "\n".join(lines)


def selected_instead(learned: Learned) -> dict[str, str]:
    """Return effects with evidence in a step that included another effect, each with the name of that effect."""
    return {
        one.name: step.added
        for step in learned.steps
        if step.added is not None
        for one in step.candidates[1:]
        if one.gain > learned.decisions.alternative_nats and one.name not in learned.added
    }


def _event_line(one: Event) -> str:
    """Return time, place and size of a single event, and the option that adds it to a simulation."""
    along, across, yaw = one.along_m, one.across_m, one.yaw_rad
    parts = [f"{abs(along) * 1e3:.0f} mm {'back' if along > 0.0 else 'forwards'}"] if abs(along) > 1e-3 else []
    parts += [f"{abs(across) * 1e3:.0f} mm to the {'right' if across > 0.0 else 'left'}"] if abs(across) > 1e-3 else []
    parts += [f"{degrees(abs(yaw)):.1f} deg to the {'right' if yaw > 0.0 else 'left'}"] if abs(yaw) > 2e-3 else []
    moved, lasts_s = ", ".join(parts), max(one.end_s - one.start_s, 1e-3)
    push = f"along={-along:.4g},across={-across:.4g},yaw={-yaw:.4g},time={one.start_s:.4g},duration={lasts_s:.4g}"
    x, y = one.place_xy
    return (
        f"once, {one.recording} from {one.start_s:.1f} to {one.end_s:.1f} s near ({x:.1f}, {y:.1f}): the robot was "
        f"moved {moved or 'hardly'}, which is not in the odometry (a push, a lift, a bump, or a jump of the truth); "
        f"left out of the fit. To corrupt with it: --effect push:{push}"
    )


def _disagreement_line(one: ParameterDifference, learned: Learned) -> str:
    says = ", ".join(
        f"{value_text(value, error, one.unit)} in {name}"
        for name, value, error in zip(one.recordings, one.values, one.standard_errors, strict=True)
    )
    slow = [gain.effect.name for gain in learned.noise if gain.effect.name in CORRELATED_NOISE]
    noise = f" ({slow[0]} may be caused by that)" if slow else ""
    groups = f" ({words})" if (words := groups_words(one)) else ""
    return (
        f"the recordings disagree about {one.effect}: {says}{groups}. The robot changed between them{noise}: "
        "learn from recordings of one state of the robot"
    )


def groups_words(one: ParameterDifference) -> str:
    """Return by how much a parameter is larger in one group of recordings than in the other; "" without groups."""
    more, low, high = one.groups or (0.0, [], [])
    return f"{value_text(more, None, one.unit)} larger in {', '.join(high)} than in {', '.join(low)}" if high else ""


def contradiction(one: Candidate) -> str:
    """Return a sentence that the data contradict a physical bound, and what to check."""
    return (
        f"the data contradict physics: {one.name} would explain {one.score.nats:.0f} nats, but {one.refused}. Check "
        "stamps and integration of odometry and truth, the point that the truth follows, and the signs of the axes"
    )


def unnamed(why: str, *, found: bool) -> str:
    """Return the sentence on a rejected model that lacks no known effect.

    found : whether the search found an effect
    """
    return f"no {'further ' if found else ''}known effect is missing, but the model is rejected: {why}"


def evidence_words(unknown: Dependence) -> str:
    """Return on what an error depends, how plainly, and whether an effect may explain it as well, as a clause."""
    rest = "no known effect explains it"
    if unknown.instead_of:
        rest = f"these data do not separate that from {' and '.join(unknown.instead_of)}"
    return f"{dependence(unknown)} ({unknown.nats:.0f} nats), and {rest}"


def dependence(unknown: Dependence) -> str:
    """Return the regressors that an error depends on, as a clause."""
    regressor = ": ".join(filter(None, (unknown.regressor.replace("_", " "), unknown.place)))
    if unknown.wheels:
        whose = "of each wheel" if unknown.wheels == "wheels" else f"of the {unknown.wheels} wheel"
        return f"the error {whose} depends on {regressor}"
    if unknown.name.startswith("twist_"):
        return f"the error of travel and turns alike depends on {regressor}"
    per = {"rad": " per radian turned", "s": " per second"}.get(unknown.per, "")
    return f"the {unknown.channel} error{per} depends on {regressor}"


def alternative(unknown: Dependence, hardly: Container[str]) -> str:
    """Return the clause of a dependence with the effects that it may replace.

    hardly : names of effects that are hardly likely, and so are not named before it
    """
    if not unknown.instead_of:
        return dependence(unknown)
    others = " and ".join(unknown.instead_of)
    if all(name in hardly for name in unknown.instead_of):
        return f"{dependence(unknown)} (rather than {others})"
    return f"or, instead of {others}, {dependence(unknown)}"


def shares_text(sequence: Sequence[ModelEvaluation]) -> str:
    """Return the reduction of the held-out error by each step, after 10 s, 10 m and 50 m; "" with one model."""
    lines = ["held-out position error (RMS):"]
    for before, after in pairwise(sequence):
        parts = [_fall("10 s", before.ten_second_error_m, after.ten_second_error_m)]
        parts += [_fall(f"{d:g} m", position_error(before, d), position_error(after, d)) for d in (10.0, 50.0)]
        lines.append(f"  {after.name:<18}{'   '.join(part for part in parts if part)}")
    return "\n".join(lines) if len(sequence) > 1 else ""


def position_error(evaluation: ModelEvaluation, distance_m: float) -> float:
    """Return the position error (m, RMS) after a path length; NaN if no segment is that long."""
    return joint_rmse(distance_windows(piece.left, distance_m) for piece in evaluation.pieces)


def _fall(what: str, before: float, after: float) -> str:
    if not (isfinite(before) and isfinite(after) and before > 0.0):
        return ""
    return f"{what}: {size('along', before)} -> {size('along', after)} ({100.0 * (after / before - 1.0):+.0f} %)"


def candidates_table(step: Step) -> str:
    """Return the candidates of one step, those with most evidence first."""
    lines = [f"{'effect':<21}{'estimate':<44}{'evidence':>10}{'held out':>16}{'10 s error':>20}"]
    for candidate in step.candidates[:8]:
        score = candidate.score
        values = ", ".join(
            f"{p.name} {value_text(float(v), float(e), p.unit)}" if score.separable else "-"
            for p, v, e in zip(amplitudes(score.effect), score.estimate, score.standard_error, strict=True)
        )
        evidence = f"{candidate.evidence:+.1f}"
        held = f"{score.held_out_nats:+.1f} +- {score.held_out_error:.1f}"
        before, after = candidate.rmse
        drift = f"{before * 1e3:.1f} -> {after * 1e3:.1f} mm" if candidate.fitted is not None else ""
        refused = f"  ({candidate.refused})" if candidate.refused else ""
        lines.append(f"{score.effect.name:<21}{values:<44}{evidence:>10}{held:>16}{drift:>20}{refused}")
    return "\n".join(lines)


def _added_line(one: Found, step: Step) -> str:
    """Return an added effect with the 10 s error of the fitted data before and after."""
    before, after = step.candidates[0].rmse
    rivals = f" (= {', '.join(one.aliases)}: the same error)" if one.aliases else ""
    rivals += f" (or {', '.join(one.rivals)}: these data do not separate them)" if one.rivals else ""
    name = one.effect.name + words_text(one.effect)
    return (
        f"  + {name:<21}{one.nats:+8.1f} nats   "
        f"{before * 1e3:6.1f} -> {after * 1e3:.1f} mm after 10 s   {one.probability}{rivals}"
    )


def fit_text(result: RobotFit, *, clocks: bool = True) -> str:
    """Return the result of a fit; without clocks if these are reported separately."""
    truth = result.fit.noise.truth
    names = [r.name for r in result.fit.problem.recordings]
    lines = [f"law {result.fit.problem.approach.law_name}, coefficients with 95 % intervals:"]
    lines += [_interval_line(result, interval) for interval in result.intervals]
    lines += [
        f"  {effect.name}{words_text(effect)}: {', '.join(numbers_text(effect, errors))}"
        for effect, errors in effects_with_errors(result.fit)
    ]
    lines += clock_lines(names, result.clocks) if clocks else []
    wander = f", wandering {truth.random_walk * 1e3:.2g} mm per sqrt(s)" if truth.random_walk else ""
    heading = f"{degrees(truth.yaw_rad):.2g} deg" if result.fit.problem.headings else "no headings"
    lines.append(f"the truth's own noise: {truth.xy_m * 1e3:.2g} mm, {heading}{wander}")
    if found := events(result.fit):
        # the largest ones, with the time since the recording's first odometry
        total = sum(event.end_s - event.start_s for event in found)
        lines.append(f"{len(found)} stretches ({total:.1f} s) are outliers with reduced weight; the largest:")
        largest = sorted(found, key=lambda e: abs(e.along_m) + abs(e.yaw_rad), reverse=True)[:8]
        lines += [
            f"  {e.recording} {e.start_s:8.1f} to {e.end_s:.1f} s: odometry {e.along_m * 1e3:+.0f} mm ahead of the "
            f"truth, {degrees(e.yaw_rad):+.2f} deg"
            for e in sorted(largest, key=lambda e: (e.recording, e.start_s))
        ]
    lines.append(f"position error after 10 s on the fitted data: {result.ten_second_error_m * 1e3:.1f} mm")
    return "\n".join(lines)


_CAUSES = {"trans": "metre", "rot": "radian", "time": "second"}


def _interval_line(result: RobotFit, interval: Interval) -> str:
    name, value = interval.name, interval.value
    scale, unit = (degrees(1.0), "deg") if name.startswith("rot_") else (1e3, "mm")
    ends = f"[{interval.low:.2g}, {interval.high:.2g}]"
    if not interval.identifiable:
        return f"  {name:<13}{'-':<10} {ends:<22}  not identifiable from this drive"
    human = "as the law has it"
    if result.fit.problem.approach.law_name == "diffusion":
        human = f"= {value * scale:.3g} {unit} after one {_CAUSES[name.partition('_')[2]]}"
    return f"  {name:<13}{value:<10.4g} {ends:<22}  {human}"


def laws_table(results: Mapping[str, RobotFit]) -> str:
    """Return all laws side by side, the likeliest first; each coefficient costs half the logarithm of the data."""
    best = next(iter(results.values())).information_nats
    lines = [f"{'law':<12}{'nats behind the best':>22}{'coefficients':>14}   depends on the step"]
    for name, result in results.items():
        behind = best - result.information_nats
        step = "yes" if result.fit.problem.approach.law.per_step else "no"
        lines.append(f"{name:<12}{behind:>22.1f}{len(result.fit.components.active):>14}   {step}")
    return "\n".join(lines)


def learned_json(
    learned: Learned,
    sequence: Sequence[ModelEvaluation],
    advice: Advice,
    *,
    evaluated: ModelEvaluation | None = None,
    fit: Fit | None = None,
) -> dict[str, Any]:
    """Return the findings of a search as values by name, without the schema; found are clocks, effects, then noise.

    sequence : models in the order of the search, cross-validated, see `sequence_comparison`
    evaluated : evaluation of the final model, if available: the last model of the sequence lacks noise terms
    fit : fit of the final model, if it is not that of the search
    """
    found = [*_clocks_found(learned)]
    for place, one in enumerate(effects_found(learned)):
        held_out = None
        if sequence[place + 1].judged_on != "fitted data":
            before, after = (_step(sequence[i]) for i in (place, place + 1))
            keys = ("nats_per_m", "rmse_10m", "rmse_50m", "rmse_10s")
            held_out = {key: [before[key], after[key]] for key in keys}
        spans = (("10s", "ten_seconds"), ("50m", "far")) if (own := learned.contributions.get(one.effect.name)) else ()
        moved = {key: (s := getattr(own, x)) and picked(s, "moved_m", "error_m", "travelled_m") for key, x in spans}
        found.append(_entry(one) | {"held_out": held_out, "contribution": moved or None})
    found += map(_entry, noise_found(learned))
    mistakes = learned.fit.problem.recordings[0].mistakes
    missing = bool(learned.lacking or learned.noise or mistakes)
    unknown = learned.unexplained or is_unexplained(learned, evaluated)
    return {
        "verdict": "unknown" if unknown else "missing" if missing else "complete",
        "rejected": (evaluated and comparisons.rejection(evaluated)) or None,
        "recordings": [
            picked(
                one, "name", "notes", odometry_pulled_per_s="pulled_per_s",
                odometry_pose_corrections="pose_corrections",
            )
            for one in learned.fit.problem.recordings
        ],
        "mistakes": [one._asdict() for one in mistakes],
        "drive_type": {"name": learned.drive_type.name, "guessed_because": learned.drive_type.reason or None},
        "found": found,
        "candidates": [
            picked(c.score, "p", "held_out_nats", effect="effect.name")
            | {"evidence_nats": c.evidence, "refused": c.refused or None}
            | {"estimate": {p.name: v for p, v in zip(amplitudes(c.score.effect), c.score.estimate, strict=True)}}
            for c in learned.rounds[0].candidates
        ],
        "unknown": [
            _unknown(one) | {"negligible": learned.hardly_moves(one.law)} for one in dependences_found(learned, fit)
        ],
        "not_testable": [
            {"effect": one.effect, "why": one.why, "drive": drive_sentence(one.plan) if one.plan else one.hint}
            for one in advice.untestable
        ],
        "events": [
            picked(one, "recording", "start_s", "end_s", "along_m", "across_m", "yaw_rad")
            | dict(zip(("x_m", "y_m"), one.place_xy, strict=True))
            for one in single_events(learned.fit)
        ],
        "disagreements": [
            picked(one, "effect", "parameter", "unit", "p")
            | {"groups": one.groups and dict(zip(("difference", "smaller", "larger"), one.groups, strict=True))}
            | {
                "recordings": [
                    {"name": name, "value": value, "standard_error": error}
                    for name, value, error in zip(one.recordings, one.values, one.standard_errors, strict=True)
                ]
            }
            for one in learned.disagreements
        ],
        "contradictions": [picked(one, effect="name", why="refused") for one in learned.contradictions],
        "ladder": [_step(evaluation) for evaluation in sequence],
        "choices": [
            picked(choice, "names", "why", "hint")
            | {
                "drive": drive_sentence(choice.plan) if choice.plan else None,
                "expected_nats": choice.nats if choice.plan else 0.0,
            }
            for choice in advice.choices
        ],
        "detectable": [picked(limit, "effect", "parameter", "size", "unit") for limit in advice.limits],
        "next_drive": advice.best
        and picked(advice.best, "duration_s", "floor_m", manoeuvre="manoeuvre.name")
        | {"drive": drive_sentence(advice.best)},
    }  # fmt: skip


def reproduction_json(one: Reproduction) -> dict[str, Any]:
    """Return the drift of a model relative to that of the recordings it was learned from."""
    long = {"measured_rmse": "measured_m", "corrupted_rmse": "drawn_m", "corrupted_rmse_least": "least_m"}
    return {
        **picked(one, "holds", measured_rmse_10s="measured_m", corrupted_rmse_10s="drawn_m"),
        "corrupted_rmse_10s_range": [one.least_m, one.most_m],
        "long": one.long and picked(one.long, "after_s", **long),
        "outliers": picked(one, count="outliers", duration_s="outlier_s", share="outlier_share"),
        "sentence": reproduction_sentence(one) or None,
    }


def _clocks_found(learned: Learned) -> Iterable[dict[str, Any]]:
    """Return the significant clock effects, with those of the first run representing all."""
    firsts = {one.name: one for one in reversed([*clocks_found(learned.clocks)])}
    if not firsts:
        return
    change = clock_gain(learned.fit.problem.recordings, learned.clocks.clocks)
    gain = picked(change, rmse_10m="after_10m", rmse_50m="after_50m", rmse_10s="after_10s")
    for one in reversed(firsts.values()):
        kind = registry()[one.name]
        effect = kind(**{amplitudes(kind)[0].name: one.value})
        held_out = {"nats_per_m": [None, None], **gain}
        yield _entry(Found(effect, [one.error], one.confidence, 0.0)) | {"held_out": held_out}


def _unknown(found: FoundDependence) -> dict[str, Any]:
    law = found.law
    return {
        **picked(found, "expression", in_model="fitted"),
        **picked(law, "channel", depends_on="regressor"),
        "detail": picked(law, "centres", "curve", "nats", "per", "wheels", standard_error="curve_error", p="score.p"),
        "parameters": {
            name: {"value": value, "unit": unit, "standard_error": error}
            for name, (value, error, unit) in found.numbers.items()
        },
        "instead_of": ", ".join(law.instead_of) or None,
    }


def _entry(one: Found) -> dict[str, Any]:
    more = {"alternatives": one.step.alternatives if one.step else (), "confidence": one.confidence}
    return _effect(one.effect, one.errors) | more | {"held_out": None, "negligible": one.negligible}


def _effect(effect: Effect, errors: Sequence[float]) -> dict[str, Any]:
    """Return an effect with its parameters, amplitudes with standard errors first, and its word-valued parameters."""
    known = dict(zip((p.name for p in amplitudes(effect)), errors, strict=False))
    own = sorted(parameters(effect), key=lambda p: not p.amplitude)
    return {
        **picked(effect, "kind", effect="name"),
        "parameters": {
            p.name: {"value": getattr(effect, p.name), "standard_error": known.get(p.name), "unit": p.unit} for p in own
        },
        "words": picked(effect, *choices(effect)),
    }


def _step(evaluation: ModelEvaluation) -> dict[str, Any]:
    return {
        **picked(evaluation, model="name", rmse_10s="ten_second_error_m", nats_per_m="nats.per_m"),
        "rmse_10m": position_error(evaluation, 10.0),
        "rmse_50m": position_error(evaluation, 50.0),
    }


def fit_json(result: RobotFit, laws: Mapping[str, RobotFit]) -> dict[str, Any]:
    """Return a fit as values by name, without the schema.

    result : fit of a robot
    laws : fits of all laws if all were tried, the likeliest first
    """
    fit = result.fit
    pairs = zip(fit.problem.recordings, result.clocks.clocks, result.clocks.errors, strict=True)
    best = next(iter(laws.values())).information_nats if laws else 0.0
    return {
        **picked(fit, law="problem.approach.law_name", log_likelihood_nats="log_likelihood"),
        "coefficients": {i.name: picked(i, "value", "low", "high", "identifiable") for i in result.intervals},
        "effects": [_effect(effect, errors) for effect, errors in effects_with_errors(fit)],
        "clocks": [
            {"recording": recording.name, **picked(clock, "offset_s", skew="rate")}
            | dict(zip(("offset_error_s", "skew_error"), spread, strict=True))
            for recording, clock, spread in pairs
        ],
        "truth_noise": picked(fit.noise.truth, "xy_m", "yaw_rad", wander="random_walk"),
        "rmse_10s": result.ten_second_error_m,
        "laws": {name: {"nats_behind": best - one.information_nats} for name, one in laws.items()},
    }


_LEAST_TURNED_RAD, _LEAST_APART_M = radians(0.1), 0.005
"""Least yaw and displacement of the truth's tracked point that are reported; mountings are rarely measured better."""
_PERHAPS = "perhaps"
"""Label of names below even odds."""
_HARDLY = 0.05
"""Confidence below which a part of the model is no finding: it is named beside the findings, if there are any."""
_TO_DECIDE, _DECIDES = "to decide, learn from a second drive as well", "a second drive decides"
_OF_ONE_DRIVE = ("time", "distance")
"""Regressors that no manoeuvre varies: another drive shows whether an error recurs."""


_EXACT = Line("exact", "0.1 mm of error per metre at most: a simulator's odometry, or a truth made of it", weight=FIRST)


_NAMED, _SET_UP, _NOT_IN_MODEL, _NOISE, _DOUBTFUL = range(5)
"""Groups of findings in their order; names below even odds are doubtful."""


def findings_brief(
    search: Learned,
    advice: Advice,
    comparison: Comparison,
    *,
    robot: RobotFit | None = None,
    written: MotionModel | None = None,
    notes: Sequence[str] = (),
    alerts: Sequence[str] = (),
    reproduction: Reproduction | None = None,
) -> Summary:
    """Return the findings of a search: each effect with size and probability, held-out errors, undecided alternatives.

    search, advice : the findings, and the alternatives that the data leave undecided
    comparison : the evaluated models; the first one lacks the findings
    robot : final fit of the robot, if it is not that of the search, with the noise that a localisation hides
    written : the model as written, which may lack findings that cannot be applied
    notes, alerts : the reader's notes on the recordings, and findings that are shown in any case
    reproduction : drift of the final model relative to the recordings, if known
    """
    exact = search.hardly_errs and not search.fit.effects  # without a model, not beside one
    fit, last = search.fit if robot is None else robot.fit, comparison.evaluations[-1]
    lines, negligible = _found_lines(search, fit, {name for choice in advice.choices for name in choice.names})
    verdict, tone = _verdict(search, comparison, lines)
    bursts = any(noise.effect.name == "slip_burst" for noise in search.noise)
    # errors and warnings follow the effects and dependences with evidence, and precede noise and clocks
    at = max(next((i for i, line in enumerate(lines) if line.label), len(lines)), 1)
    mounted = _mounting_words(search, fit)
    changes = [one.change for one in agreement_of(comparison).measures]
    falls = not comparison.evaluations[1:] or ("better" in changes and changes[0] != "worse")
    unexplained = is_unexplained(search, last, falls=falls)
    named = verdict != "COMPLETE" and bool(lines) and not unexplained
    if named:
        first = ": ".join(filter(None, (lines[0].label.replace(_PERHAPS, ""), lines[0].text)))
        if comparison.raw_error_m - comparison.clock_error_m > comparison.clock_error_m - last.ten_second_error_m:
            first = "; ".join([*_clock_words(search), first])  # most of the error is the clock's
        lines += [Line("set-up", mounted, weight=FIRST)] if mounted else []
    else:
        apart = ", and ".join([*_clock_words(search), *([mounted] if mounted else [])])
        none = "no relevant effect is missing" if negligible else "no known effect explains more than chance"
        first = f"the robot's model is complete; {apart}" if apart else none
    if unexplained:
        ratios = search.fit.problem.recordings[0].ratios or "a first look shows no plain mistake"
        verdict, tone, first = "UNKNOWN", "warning", f"nothing found explains the errors; {ratios}"
    elif reproduction is not None and reproduction.too_small and reproduction.by_outliers and not named:
        verdict, tone, first = "MISSING", "warning", "slip_burst or push: intervals that the fit left out as outliers"
    elif verdict == "COMPLETE" and last.verdict.fails and not exact:
        verdict, tone = "PROBABLY", "warning"
    lines = [Line(verdict, first, tone), *lines[named:]]
    lines[at:at] = [
        *_change_lines(search, fit, written),
        *(Line("data", alert, "warning", FIRST) for alert in alerts),
        *([_EXACT] if exact else _misfit_lines(reproduction, last, bursts=bursts)),
        *_written_lines(search, written),
        # the identity of an effect is more important than its gain
        *open_lines(search, advice),
        *untested_lines(search, advice, named=named),
        *drive_lines(search),
        *_error_lines(comparison),
    ]
    lines += [*hidden_noise(robot), *track_lines(search, failed=last.verdict.fails), *negligible]
    if reproduction is not None and reproduction_sentence(reproduction) and bursts:
        # noise that causes most of the error is more important than effects that cause less
        lines = [line._replace(weight=FIRST) if line.label == "noise" else line for line in lines]
    if notes := tuple(dict.fromkeys(notes)):
        said = notes[0] if len(notes) == 1 else f"{len(notes)} remarks: -v shows them"
        lines.append(Line("notes", said, "warning", SPARE))
    return Summary(tuple(lines))


def _change_lines(search: Learned, fit: Fit, written: MotionModel | None) -> list[Line]:
    """Return what to set in the robot's odometry, if sizes of wheels or their distance were found to be wrong."""
    sure = {one.effect.name for one in effects_found(search, fit) if not are_doubtful([one])}
    own = [] if written is None else [effect for effect in written.effects if effect.name in sure & WHEEL_EFFECTS]
    if written is None or not own:
        return []
    if any(effect.name == "unequal_wheels" for effect in own) and written.track_m is None:
        steers = "" if search.drive_type.stated else ", or its steering's zero (--drive-type car)"
        return [Line("change", f"wheel radii differ (--track){steers}", weight=FIRST)]
    separation, left, right = wheel_multipliers(replace(written, effects=tuple(own))).values()
    radius = 0.5 * (left + right)
    sizes = {"wheel_separation": separation, **({"wheel_radius": radius} if left == right else {})}
    verbs = {radius / separation: "turns"}
    verbs[radius] = "turns and travels" if radius in verbs else "travels"
    seen = [
        f"{verb} {100.0 * abs(ratio - 1.0):.2g} % {'more' if ratio > 1.0 else 'less'} than its odometry says"
        for ratio, verb in verbs.items()
        if ratio != 1.0
    ]
    if left != right:
        sizes |= {"left wheel's radius": left, "right one's": right}
        seen.append(f"bends to the {'left' if right > left else 'right'} where its odometry is straight")
    said, changed = " and ".join(seen), {name: ratio for name, ratio in sizes.items() if ratio != 1.0}
    long, short = (", ".join(f"{name} {to} {ratio:.4f}" for name, ratio in changed.items()) for to in ("to", "x"))
    return [Line("change", f"the robot {said}: set {long} of its value", weight=FIRST, short=f"{said}: {short}")]


def _error_lines(comparison: Comparison) -> list[Line]:
    """Return the errors without and with the findings by all measures; of one model with the clock, if that is off."""
    if len(comparison.evaluations) == 1:
        before, after = comparison.raw_error_m, comparison.clock_error_m
        said = f"10 s error {size('along', before)} -> {size('along', after)} with the clock corrected"
        return [Line("errors", said, weight=ALWAYS)] if before != after and isfinite(after) else []
    held, verdict = comparisons.HELD[comparison.judged_on], agreement_of(comparison).verdict
    said, short = (f"{comparisons.measures_words(comparison, most=most)} ({held})" for most in (None, 1))
    said += "; effects are chosen by likelihood" if verdict == "mixed" else ""
    return [Line("errors", said, comparisons.TONES[verdict], ALWAYS, short)]


def _written_lines(search: Learned, written: MotionModel | None) -> list[Line]:
    """Return the effects of the fit that the written model lacks."""
    kept = {effect.name for effect in written.effects} if written is not None else set(search.added)
    absent = [e.name for e in search.fit.effects if e.kind != "setup" and e.name in set(search.added) - kept]
    said = f"without {' and '.join(absent)}, which cannot be applied as found (-v states why)"
    return [Line("model", said, "warning", FIRST)] if absent else []


def _misfit_lines(reproduction: Reproduction | None, last: ModelEvaluation, *, bursts: bool) -> list[Line]:
    """Return how far a simulation would drift, if far too little or too much, and by how much the model is rejected."""
    lines = []
    if reproduction is not None and not (reproduction.holds and bursts):
        label, said = "outliers" if reproduction.holds else "drift", reproduction_sentence(reproduction)
        lines += [Line(label, said, "warning", FIRST)] if said else []
    if last.verdict.fails:
        said = f"errors are {comparisons.plainly(last.verdict.misfit)} times the predicted ones"
        said = f"the noise is too large: {said}" if last.verdict.misfit < 1.0 else said
        lines.append(Line("rejected", said, "warning", FIRST))
    return lines


def _verdict(search: Learned, comparison: Comparison, lines: Sequence[Line]) -> tuple[str, Tone]:
    """Return the first word of a summary and its tone.

    lines : the findings as of `_found_lines`
    """
    if not (search.lacking or search.noise or search.unexplained):
        return "COMPLETE", "good"
    if lines and (lines[0].label == _PERHAPS or lines[0].weight == SPARE):
        return _PERHAPS.upper(), "warning"
    if search.unexplained and not search.laws:
        # an effect was identified, but a dependence beside it remains unexplained
        return "UNKNOWN" if are_doubtful(effects_found(search)) else "PROBABLY", "warning"
    held, last = agreement_of(comparison).verdict, comparison.evaluations[-1].verdict
    if held == "worse" or (last.fails and last.misfit > GROSS):
        return "PROBABLY", "warning"
    return "MISSING", "warning" if held == "mixed" else "good"


def _clock_words(search: Learned) -> list[str]:
    """Return the findings about the clocks of the recordings."""
    said = []
    for one in {one.name: one for one in reversed([*clocks_found(search.clocks)])}.values():
        late, early = ("odometry", "truth") if one.value > 0.0 else ("truth", "odometry")
        offset = one.name == "time_offset"
        by = f"{float(f'{abs(one.value) * (1e3 if offset else 6e4):.2g}'):g} ms"
        runs = search.fit.problem.recordings
        where = f" in {runs[one.recording].name}" if len(runs) > 1 else ""
        apart = f"the two clocks run apart by {by} a minute"
        said.append((f"the {late} is stamped {by} later than the {early}" if offset else apart) + where)
    return said


def _largest(search: Learned) -> str:
    """Return the name of the effect by which odometry is displaced most in 10 s: the cause, also if of the set-up."""
    moved_m = {name: one.ten_seconds.moved_m for name, one in search.contributions.items()}
    return max(moved_m, key=moved_m.__getitem__, default="")


def _mounting_words(search: Learned, fit: Fit) -> str:
    """Return where the truth's tracked point sits on the robot and how it is turned, if significant; "" if not.

    A smaller set-up effect that the search selected has a line of its own.
    """
    said = []
    for effect, errors in effects_with_errors(fit):
        values = [getattr(effect, p.name) for p in amplitudes(effect)]
        if effect.name in search.added and effect.name != _largest(search):
            continue
        if effect.name == "mount_yaw" and abs(values[0]) > max(SIGNIFICANT * errors[0], _LEAST_TURNED_RAD):
            against = " against TF" if any(r.matched for r in fit.problem.recordings) else ""
            said.append(f"the truth is turned by {degrees(values[0]):.2g} deg{against}")
        elif effect.name == "lever_arm":
            sides = zip(values, errors, (("ahead of", "behind"), ("left of", "right of")), strict=True)
            where = [
                f"{f'{abs(v):.3g} m' if abs(v) >= 1.0 else f'{abs(v) * 1e2:.2g} cm'} {words[v < 0.0]}"
                for v, e, words in sides
                if abs(v) > max(SIGNIFICANT * e, _LEAST_APART_M)
            ]
            twins = readings_of(effect, search.drive_type)
            other = f" (lever_arm, or {' or '.join(twins)} of the robot)" if twins else " (lever_arm)"
            said.append(f"the truth follows a point {' and '.join(where)} the base{other}" if where else "")
    return ", and ".join(filter(None, said))


def _found_lines(search: Learned, fit: Fit, undecided: set[str]) -> tuple[list[Line], list[Line]]:
    """Return a line for each effect, dependence, noise and clock found; and a line of negligible ones.

    Effects and dependences of the model come first, in order of their evidence; then dependences that are not in the
    model, noise, names below even odds, and the set-up. Negligible findings share one line, because they require no
    action, and so do parts of the model that are hardly causes, if anything else was found.

    undecided : names in the line of undecided alternatives
    """
    ranked: list[tuple[tuple[int, float], Line]] = []  # in a group the one with the most evidence is first
    ranks: dict[str, tuple[int, float]] = {}
    small: dict[str, str] = {}  # texts of negligible parts by name
    absent: list[str] = []  # negligible and not in the model
    effects = effects_found(search, fit)
    sure = not are_doubtful(effects)
    hardly = {one.effect.name for one in effects if one.confidence < _HARDLY}
    for one in effects:
        name, said = one.effect.name, f"{one.names}  {', '.join(one.numbers)}"
        if one.negligible:
            small[name] = said
            continue
        rivals = [rival for rival in one.rivals if rival not in undecided]
        said += f"  {one.probability}"
        said += f", or {', '.join(rivals)}" if rivals else ""
        doubtful = one.confidence < EVEN_ODDS
        group, label = (_DOUBTFUL, _PERHAPS) if doubtful else (_NAMED, "")
        if name in search.of_setup and name != _largest(search):
            group, label = _SET_UP, "set-up"
        ranks[name] = (group, -inf if name == _largest(search) else -one.nats)
        # without any likelier effect it is what the errors fall by
        weight = FOUND if not doubtful else SPARE if sure else USUAL
        ranked.append((ranks[name], Line(label, said, weight=weight, part="" if group == _SET_UP else _part(one))))
    for unknown in foremost(dependences_found(search, fit), 2):
        law = unknown.law
        if law in search.unexplained or law.instead_of:
            named, remark = alternative(law, hardly), _left_out(unknown)
            said = f"{named}: {unknown.expression}{remark}"
            short = "" if unknown.fitted else f"{named}{f': {_DECIDES}' if _TO_DECIDE in remark else remark}"
            beside = [ranks[name] for name in law.instead_of if name in ranks]
            own = (_NAMED if unknown.fitted else _NOT_IN_MODEL, -law.nats)
            rank = max(beside, default=own)
            weight = FOUND if unknown.fitted else USUAL if rank[0] <= _NOT_IN_MODEL else SPARE
            ranked.append((rank, Line("", said, weight=weight, short=short, part=unknown.part)))
        elif unknown.fitted:
            small[unknown.part] = unknown.expression
        else:
            absent.append(unknown.expression)
    for noise in noise_found(search):
        said = f"{noise.names}, {', '.join(noise.numbers)}  {noise.probability}"
        doubtful = noise.confidence < EVEN_ODDS
        group = _DOUBTFUL if doubtful else _NOISE
        ranked.append(((group, 0.0), Line("noise", said, weight=SPARE if doubtful else USUAL, part=_part(noise))))
    likely = [one for one in effects if not (one.negligible or one.effect.name in search.of_setup)]
    lines = _beside_findings(ranked, [*likely, *noise_found(search)])
    lines += _clock_lines(search.clocks, search.fit)
    lines += [
        Line(
            "disagree",
            f"recordings disagree about {one.effect} (p {one.p:.2g}): {groups_words(one) or 'did the robot change?'}",
            "warning",
        )
        for one in search.disagreements
    ]
    lines += [Line("data", contradiction(one), "warning") for one in search.contradicted]
    trivial = [f"{', '.join(small.values())}: in the model, but negligible"] if small else []
    trivial += [f"{', '.join(absent)}: negligible, and not in the model"] if absent else []
    return lines, [Line("negligible", "; ".join(trivial), weight=SPARE, part=", ".join(small))] if trivial else []


def _beside_findings(ranked: Sequence[tuple[tuple[int, float], Line]], parts: Sequence[Found]) -> list[Line]:
    """Return lines in order, with one line for all parts that are hardly causes if there are other findings."""
    hardly = [_part(one) for one in parts if one.confidence < _HARDLY]
    ordered = sorted(ranked, key=lambda one: one[0])
    findings = [(rank, line) for rank, line in ordered if line.part not in hardly]
    if not hardly or all(group == _SET_UP for (group, _), _ in findings):
        return [line for _, line in ordered]
    named = ", ".join(hardly)
    return [*(line for _, line in findings), Line("included", f"also {named}", weight=SPARE, part=named)]


def _part(one: Found) -> str:
    """Return the name of a part of the model, after "perhaps" below even odds, or with its confidence."""
    name = one.effect.name
    if one.confidence < _HARDLY:
        return f"{name} ({confidence_words(one.confidence)})"
    return name if one.confidence >= EVEN_ODDS else f"{_PERHAPS} {name}"


def _left_out(unknown: FoundDependence) -> str:
    """Return that a dependence is reported only, not in the model, and what decides; "" if nothing is to be said."""
    law = unknown.law
    if unknown.fitted:
        return ""
    other = _TO_DECIDE if law.regressor in _OF_ONE_DRIVE else ""
    if law.instead_of:
        return f" ({other})" if other else ""
    if unknown.left_out:
        return f" (left out of the model: {unknown.left_out})"
    return f" ({'; '.join(filter(None, ('not in the model', other)))})"


def _clock_lines(clocks: Clocks, fit: Fit) -> list[Line]:
    # parts of one run share a clock, which needs one line
    runs = fit.problem.recordings
    names = [run.clock.rpartition(" from ")[0] or run.name for run in runs]
    first = [[one.clock or one.name for one in runs].index(run.clock or run.name) for run in runs]
    found = [one for one in clocks_found(clocks) if first[one.recording] == one.recording]
    return [Line("clock", f"{one.name} {clock_text(one)} in {names[one.recording]}") for one in found]


def fit_brief(result: RobotFit) -> Summary:
    """Return the error after 10 s on the fitted data, the noise coefficients and the effects of a fit."""
    fit = result.fit
    law = fit.problem.approach.law_name
    names = ", ".join(r.name for r in fit.problem.recordings)
    error = size("along", result.ten_second_error_m)
    lines = [Line("FITTED", f"{names}: 10 s error {error} on the fitted data", "good")]
    k = fit.noise.coefficients
    numbers = [f"{i.name} {getattr(k, i.name):.3g}" for i in result.intervals if i.identifiable]
    lines.append(Line("noise", f"law {law}: {', '.join(numbers) or 'nothing identifiable'}"))
    lines += hidden_noise(result)
    hidden = [i.name for i in result.intervals if not i.identifiable]
    if hidden:
        lines.append(Line("", f"not identifiable from this drive: {', '.join(hidden)}", "warning"))
    for effect, errors in effects_with_errors(fit):
        kind = "set-up" if effect.kind == "setup" else "effect"
        lines.append(Line(kind, f"{effect.name}  {', '.join(numbers_text(effect, errors))}"))
    return Summary((*lines, *_clock_lines(result.clocks, fit)))


_LIKE_SINGLE_WHEELS = ("lever_arm", "icr_shift", "time_offset")
"""Effects that resemble errors of single wheels: a larger wheel shifts turns as the y of a lever arm does."""
_PER_METRE = {"rot_trans": "of heading", "trans_trans": "along", "across_trans": "across"}


def mistakes_first(brief: Summary, mistakes: Sequence[Mistake]) -> Summary:
    """Return a summary that begins with plain mistakes: what is seen, usual causes, and what to change."""
    lines: list[Line] = []
    for one in mistakes:
        lines += [Line("MISTAKE", one.said, "bad", ALWAYS), Line("causes", one.causes, weight=FIRST)]
        lines.append(Line("change", "; ".join(filter(None, (one.change, one.then))), "warning", ALWAYS))
    rest = [one._replace(label="otherwise") if lines and one.label == "COMPLETE" else one
            for one in brief.lines if not (lines and one.label == "change")]  # fmt: skip
    return Summary((*lines, *rest), brief.most + len(lines))


def drive_lines(search: Learned) -> list[Line]:
    """Return the drive type, if names depend on an inferred one, or on the default of a robot that may be steered."""
    drive = search.drive_type
    if drive.reason:
        return [Line("drive type", f"{drive.sentence}; --drive-type overrules it")]
    of_wheels = {kind.unsteered for kind in registry().values()} & set(search.added)
    if not (drive.least_radius_m and of_wheels):
        return []
    said = f"it never turned on the spot (smallest radius {drive.least_radius_m:.2g} m): if it steers, --drive-type car"
    return [Line("drive type", said, "warning")]


def track_lines(search: Learned, *, failed: bool) -> list[Line]:
    """Return the approximations due to an unknown track, if a finding may depend on them."""
    recordings = search.fit.problem.recordings
    if search.drive_type.name != "differential" or any(r.track_m is not None for r in recordings):
        return []
    if not (search.added or search.unknown or failed or any(clocks_found(search.clocks))):
        return []
    fitted = [e.name for e in search.fit.effects if getattr(e, "track", 0.0)]
    ghosts = [name for name in search.added if name in _LIKE_SINGLE_WHEELS]
    said = f"that of {', '.join(fitted)} was fitted" if fitted else "errors of single wheels are approximated"
    said += f", {', '.join(ghosts)} may come from them" if ghosts else ""
    return [Line("track", f"not given: {said}; measure it (--track)", "warning")]


def open_lines(search: Learned, advice: Advice) -> list[Line]:
    """Return the alternatives that the data cannot separate and the drive to do so, if there are any that matter."""
    matters = tuple(choice for choice in advice.choices if not search.is_negligible(choice.names[0]))
    said = inseparable_sentence(replace(advice, choices=matters), lambda name: readings_of(name, search.drive_type))
    return [Line("open", said, "warning", SPARE)] if said else []


def untested_lines(search: Learned, advice: Advice, *, named: bool) -> list[Line]:
    """Return the effects hidden by the scale error of a gyro or laser that serves as truth, with the remedy.

    named : whether there are findings; else the frequent causes that the drives could not show are returned, too
    """
    hidden = [one for one in advice.untestable if one.limited_by_truth]
    said = [f"{one.effect}: {one.why}; {one.hint}" for one in hidden]
    names = [one.effect for one in advice.untestable if one.effect in search.decisions.common and one not in hidden]
    if names and not named:
        said.append(f"{', '.join(names)}: not visible in these data (-v: why, and what would show it)")
    return [Line("not testable", one, "warning") for one in said]


def hidden_noise(result: RobotFit | None) -> list[Line]:
    """Return a line on noise for which a localisation gives only an upper bound."""
    hidden = [] if result is None else [i for i in result.noise_at_most if i.name in _PER_METRE]
    if not hidden:
        return []
    bounds = [f"{degrees(i.high):.2g} deg" if i.name == "rot_trans" else f"{i.high * 1e3:.2g} mm" for i in hidden]
    most = ", ".join(f"{bound} {_PER_METRE[i.name]}" for bound, i in zip(bounds, hidden, strict=True))
    return [
        Line(
            "noise",
            f"at most {most} after a metre (95 %): the localisation's own errors mask it; the model has the estimate",
        )
    ]

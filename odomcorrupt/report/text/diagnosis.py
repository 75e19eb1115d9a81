"""A fit, and findings of a search, as plain text: effects, noise, unexplained dependences, detection limits."""

from __future__ import annotations

from itertools import pairwise
from math import degrees, isfinite
from typing import TYPE_CHECKING

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.report.findings import dependences_found, effects_found, effects_with_errors, foremost, noise_found
from odomcorrupt.report.text.comparison import rejection, size, within
from odomcorrupt.report.text.design import advice_text, limits_sentence
from odomcorrupt.report.text.numbers import (
    clock_lines,
    confidence_words,
    noise_text,
    numbers_text,
    value_text,
    words_text,
)
from odomcorrupt.study.estimate.clocks import RIVALS
from odomcorrupt.study.estimate.outliers import Event, events, single_events
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE
from odomcorrupt.study.estimate.windows import distance_windows, joint_rmse

if TYPE_CHECKING:
    from collections.abc import Container, Mapping, Sequence

    from odomcorrupt.report.findings import FoundDependence
    from odomcorrupt.study.design.advise import Advice
    from odomcorrupt.study.estimate.calibrate import Interval, RobotFit
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.select.candidates import Candidate
    from odomcorrupt.study.select.dependence import Dependence
    from odomcorrupt.study.select.heterogeneity import ParameterDifference
    from odomcorrupt.study.select.result import Learned, Step
    from odomcorrupt.study.validate.compare import ModelEvaluation

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
        lines += ["missing, in the order of evidence, each added to those before:", _sequence_text(learned)]
    for noise in noise_found(learned):
        probability = confidence_words(noise.confidence)
        probability += ", or the scale of the truth varies" if noise.of_truth else ""
        values = ", ".join(noise_text(noise.effect))
        lines.append(f"noise: {noise.name}, {values} ({probability}): {noise.effect.summary}")
    for unknown in foremost(dependences_found(learned, fit), 3):
        lines += _unknown_lines(unknown)
    lines += [_event_line(one) for one in single_events(learned.fit)]
    like_a_clock = [name for name in learned.added if name in RIVALS]
    if like_a_clock and learned.clocks.ambiguous_nats > 0.0:
        lines.append(
            f"{' and '.join(like_a_clock)} or a clock that is off: these data do not separate them, because the clock "
            "is significant only without them; give the offset if it is known (--truth-shift), or speed up and brake "
            "hard at two speeds, with turns on the spot between"
        )
    lines += [_disagreement_line(one, learned) for one in learned.disagreements]
    lines += [contradiction(one) for one in learned.contradicted]
    if small := [name for name in learned.added if learned.is_negligible(name)]:
        lines.append(f"negligible, though significant: {', '.join(_moved_words(name, learned) for name in small)}")
    if evaluated is not None and evaluated.verdict.fails:
        lines.append(unnamed(rejection(evaluated), found=bool(lines)))
    elif evaluated is not None and evaluated.verdict.rejected:
        lines.append(f"the model holds in practice: {within(evaluated)}")
    lines = lines or [NOTHING]
    lines += [text for text in (advice_text(advice, selected_instead(learned)), limits_sentence(advice.limits)) if text]
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


def _moved_words(name: str, learned: Learned) -> str:
    span = learned.contributions[name].ten_seconds
    return f"{name} moves {size('along', span.moved_m)} in 10 s, of {size('along', span.error_m)} that remains"


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
    return (
        f"the recordings disagree about {one.effect}: {says}. The robot changed between them{noise}: "
        "learn from recordings of one state of the robot"
    )


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


def _unknown_lines(unknown: FoundDependence) -> list[str]:
    other = " and ".join(unknown.law.instead_of)
    finding = f"{f'or instead of {other}' if other else 'unknown'}: {evidence_words(unknown.law)}"
    spread = ", ".join(f"{name} {value_text(*number)}" for name, number in unknown.numbers.items())
    shown = f"{unknown.expression}{f'  ({spread})' if spread else ''}"
    mean = [f"  in the model: its mean, {unknown.mean:.4g}"] if unknown.mean is not None else []
    return [finding, f"  {'fitted' if unknown.fitted else 'suggested'}: {shown}", *mean]


def evidence_words(unknown: Dependence) -> str:
    """Return on what an error depends, how plainly, and whether an effect may explain it as well, as a clause."""
    rest = "no known effect explains it"
    if unknown.instead_of:
        rest = f"these data do not separate that from {' and '.join(unknown.instead_of)}"
    return f"{dependence(unknown)} ({unknown.nats:.0f} nats), and {rest}"


def dependence(unknown: Dependence) -> str:
    """Return the regressors that an error depends on, as a clause."""
    regressor = ": ".join(filter(None, (unknown.regressor.replace("_", " "), unknown.place)))
    if unknown.wavelength_m is not None:
        return f"the {unknown.channel} error is periodic, every {unknown.wavelength_m:.3g} m driven"
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


_MOST_CANDIDATES = 8


def candidates_table(step: Step) -> str:
    """Return the candidates of one step, those with most evidence first."""
    head = f"{'effect':<21}{'estimate':<44}{'evidence':>10}{'held out':>16}{'10 s error':>20}"
    return "\n".join([head, *map(_candidate_line, step.candidates[:_MOST_CANDIDATES])])


def _candidate_line(candidate: Candidate) -> str:
    score = candidate.score
    values = ", ".join(
        f"{p.name} {value_text(float(v), float(e), p.unit)}" if score.separable else "-"
        for p, v, e in zip(amplitudes(score.effect), score.estimate, score.standard_error, strict=True)
    )
    evidence = f"{candidate.gain:+.1f}" if candidate.fitted is not None else f"p {score.p:.2g}"
    held = f"{score.held_out_nats:+.1f} +- {score.held_out_error:.1f}"
    before, after = candidate.rmse
    drift = f"{before * 1e3:.1f} -> {after * 1e3:.1f} mm" if candidate.fitted is not None else ""
    refused = f"  ({candidate.refused})" if candidate.refused else ""
    return f"{score.effect.name:<21}{values:<44}{evidence:>10}{held:>16}{drift:>20}{refused}"


def _sequence_text(learned: Learned) -> str:
    """Return the 10 s error of the fitted data after each step."""
    lines = []
    for one in effects_found(learned):
        before, after = one.step.candidates[0].rmse
        rivals = f" (= {', '.join(one.aliases)}: the same error)" if one.aliases else ""
        rivals += f" (or {', '.join(one.rivals)}: these data do not separate them)" if one.rivals else ""
        name = one.effect.name + words_text(one.effect)
        lines.append(
            f"  + {name:<21}{one.gain_nats:+8.1f} nats   "
            f"{before * 1e3:6.1f} -> {after * 1e3:.1f} mm after 10 s   {confidence_words(one.confidence)}{rivals}"
        )
    return "\n".join(lines)


_MOST_EVENTS = 8


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
    lines += _event_lines(events(result.fit))
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


def _event_lines(found: Sequence[Event]) -> list[str]:
    """Return the downweighted segments, the largest first, with the time since the recording's first odometry."""
    if not found:
        return []
    total = sum(event.end_s - event.start_s for event in found)
    lines = [f"{len(found)} stretches ({total:.1f} s) are outliers with reduced weight; the largest:"]
    largest = sorted(found, key=lambda e: abs(e.along_m) + abs(e.yaw_rad), reverse=True)[:_MOST_EVENTS]
    lines += [
        f"  {e.recording} {e.start_s:8.1f} to {e.end_s:.1f} s: odometry {e.along_m * 1e3:+.0f} mm ahead of the truth, "
        f"{degrees(e.yaw_rad):+.2f} deg"
        for e in sorted(largest, key=lambda e: (e.recording, e.start_s))
    ]
    return lines


def laws_table(results: Mapping[str, RobotFit]) -> str:
    """Return all laws side by side, the likeliest first; each coefficient costs half the logarithm of the data."""
    best = next(iter(results.values())).information_nats
    lines = [f"{'law':<12}{'nats behind the best':>22}{'coefficients':>14}   depends on the step"]
    for name, result in results.items():
        behind = best - result.information_nats
        step = "yes" if result.fit.problem.approach.law.per_step else "no"
        lines.append(f"{name:<12}{behind:>22.1f}{len(result.fit.components.active):>14}   {step}")
    return "\n".join(lines)

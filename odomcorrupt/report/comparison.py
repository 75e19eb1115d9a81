"""A comparison in words and as JSON (schema 2 of docs/json.md): metres, radians; unknown values are a dash, or null."""

from __future__ import annotations

import math
from math import degrees, isfinite
from typing import TYPE_CHECKING, Any

from odomcorrupt.report.plain import picked
from odomcorrupt.study.validate.compare import NOT_APPLIED, agreement_of
from odomcorrupt.study.validate.goodness_of_fit import PRACTICAL_FACTOR, size_question
from odomcorrupt.summary import Line, Summary, Tone

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from odomcorrupt.study.validate.calibration import Horizon
    from odomcorrupt.study.validate.compare import Comparison, JudgedOn, ModelEvaluation
    from odomcorrupt.study.validate.lack_of_fit import Failure
    from odomcorrupt.study.validate.predictive_check import Reproduction
    from odomcorrupt.study.validate.trajectory_error import TrajectoryError


TONES: dict[str, Tone] = {"better": "good", "mixed": "warning", "worse": "bad", "same": "plain"}
"""Tone of a line on the agreement of the measures."""
_BAR = 30
_NAME = 24
"""Columns of a model's name; a longer one gets a separate line, so that bars are aligned."""

HELD: dict[JudgedOn, str] = {"recordings": "held out", "folds": "cross-validated", "fitted data": "on the fitted data"}
"""Data on which the errors and likelihoods of a comparison were computed, in words."""
_HOW: dict[JudgedOn, str] = {
    "recordings": "not fitted here",
    "folds": "refitted without the recording, or the half of the only one, that it is evaluated on",
    "fitted data": "on the data it was fitted on",
}


def comparison_text(comparison: Comparison) -> str:
    """Return horizons and verdict of every model, the sequence, and each model's lack of fit."""
    lines: list[str] = []
    for evaluation in comparison.evaluations:
        lines += [f"{evaluation.name} ({_HOW[evaluation.judged_on]})", *_horizon_lines(evaluation.horizons)]
        lines += [f"  note: {note}" for note in evaluation.notes]
        lines.append("")
    lines += [*_sequence_lines(comparison), "", *_trajectory_lines(comparison)]
    for evaluation in comparison.evaluations:
        more = len(evaluation.failures) - MOST
        fails = [f"  {number}. {sentence(f)}" for number, f in enumerate(evaluation.failures[:MOST], start=1)]
        fails += [f"  and {more} more, see --json"] if more > 0 else []
        none = "  no lack of fit in any motion, time, place or moment"
        lines += ["", evaluation_sentence(evaluation), *(fails or [none])]
    if any(j.failures for j in comparison.evaluations):
        lines += ["", SIGNS]
    return "\n".join(lines)


def comparison_brief(comparison: Comparison) -> Summary:
    """Return the verdict on the last model, and a line for each model with error, likelihood and rejection."""
    last = comparison.evaluations[-1]
    if len(comparison.evaluations) == 1:
        failed = last.verdict.fails
        words = "is rejected by these data" if failed else "explains these data"
        if last.verdict.rejected and not failed:
            words = f"holds in practice: {within(last)}"
        first = Line("REJECTED" if failed else "HOLDS", f"{last.name} {words}", "bad" if failed else "good")
    else:
        agreement = agreement_of(comparison)
        said = f"{last.name}: {measures_words(comparison)}"
        first = Line(agreement.verdict.upper(), said, TONES[agreement.verdict])
    lines = [first]
    if isfinite(comparison.raw_error_m):
        lines.append(Line("odometry", f"10 s error {size('along', comparison.raw_error_m)} as measured"))
    # largest number of models with a line each in a comparison
    shown = comparison.evaluations[-4:]
    for one in shown:
        said = f"{one.name}: 10 s error {size('along', one.ten_second_error_m)}, {one.nats.per_m:.4g} nats/m, "
        said += "rejected" if one.verdict.fails else "not rejected"
        lines.append(Line("model" if one is shown[0] else "", said))
    if last.unplaced:
        lines.append(Line("limited", f"{', '.join(last.unplaced)} {NOT_APPLIED}; errors there remain", "warning"))
    if last.verdict.fails:
        lines.append(Line("fails", sentence(last.failures[0]) if last.failures else failed_test(last), "warning"))
    elif last.failures:
        worst = sentence(last.failures[0])
        lines.append(Line("deviation", f"the largest one, too small to reject {last.name}: {worst}"))
    return Summary(tuple(lines))


def _horizon_lines(horizons: Sequence[Horizon]) -> list[str]:
    both = "measured (expected)"
    row = "  {:>6}{:>9}{:>23}{:>23}{:>20}{:>8}{:>13}{:>13}{:>13}".format
    lines = [
        row("path", "windows", "along", "across", "yaw", "NEES", "by chance", "in 50 %", "in 90 %"),
        row("", "", both, both, "measured (exp.)", "", "(95 %)", "al/ac/yaw", "al/ac/yaw"),
    ]
    for h in horizons:
        *cells, nees, chance, half, most = horizon_cells(h)
        outside = " " if h.nees_bounds[0] <= h.nees <= h.nees_bounds[1] else "*"
        lines.append(row(*cells, nees + outside, chance, half, most))
    return lines


def horizon_cells(h: Horizon) -> list[str]:
    """Return path, windows, errors along, across and of yaw (expected), NEES, its range by chance, and coverages."""
    along, across = (f"{_length(h.measured[c])} ({_length(h.expected[c])})" for c in (0, 1))
    yaw = f"{degrees(h.measured[2]):.2f} ({degrees(h.expected[2]):.2f}) deg" if isfinite(h.measured[2]) else "-"
    chance = f"{h.nees_bounds[0]:.2f} to {h.nees_bounds[1]:.2f}"
    coverages = (_percent(h.coverage_50), _percent(h.coverage_90))
    return [f"{h.distance_m:g} m", str(h.windows), along, across, yaw, f"{h.nees:.2f}", chance, *coverages]


def _percent(parts: Iterable[float]) -> str:
    return "/".join(f"{100.0 * p:.0f}" if isfinite(p) else "-" for p in parts)


def _length(metres: float) -> str:
    return f"{metres * 1e3:.1f} mm" if metres < 1.0 else f"{metres:.2f} m"


def sequence_steps(comparison: Comparison) -> list[tuple[str, float, ModelEvaluation | None]]:
    """Return names and 10 s errors (m), from the measured odometry to the last model."""
    steps: list[tuple[str, float, ModelEvaluation | None]] = [("measured odometry", comparison.raw_error_m, None)]
    if comparison.clock_error_m != comparison.raw_error_m:
        steps.append(("with its clock corrected", comparison.clock_error_m, None))
    return [*steps, *((j.name, j.ten_second_error_m, j) for j in comparison.evaluations)]


def share_of_worst(steps: Sequence[tuple[str, float, ModelEvaluation | None]], error: float) -> float:
    """Return an error relative to the largest of the sequence; 0 if unknown."""
    worst = max((e for _, e, _ in steps if isfinite(e)), default=0.0)
    return error / worst if isfinite(error) and worst > 0.0 else 0.0


def _sequence_lines(comparison: Comparison) -> list[str]:
    steps, first = sequence_steps(comparison), comparison.evaluations[0]
    lines = [f"{HELD[comparison.judged_on]} position error (RMS) after 10 s, and log likelihood:"]
    for name, error, evaluation in steps:
        bar = "#" * round(_BAR * share_of_worst(steps, error))
        nats, n = "", None if evaluation is None else evaluation.nats
        if n is not None:
            nats = f"{n.per_m:.2f} +- {n.error:.2f} nats/m"
            if evaluation is not first:
                nats += f"  ({n.gain_per_m:+.2f} +- {n.gain_error:.2f} over {first.name})"
        size = f"{error * 1e3:9.1f} mm" if isfinite(error) else f"{'-':>12}"
        lines += _named(name, f"{size}  {bar:<{_BAR}}  {nats}")
    falls = falls_sentence(comparison)
    return [*lines, f"  {falls}"] if falls else lines


def falls_sentence(comparison: Comparison) -> str:
    """Return the reduction of the error if no other measure contradicts it, else that the measures disagree.

    "" if the error does not change, or the evaluation is on the fitted data.
    """
    first, last = comparison.evaluations[0], comparison.evaluations[-1]
    if len(comparison.evaluations) < 2 or comparison.judged_on != "recordings":
        return ""
    verdict = agreement_of(comparison).verdict
    if verdict == "mixed":
        return f"from {first.name} to {last.name} {measures_words(comparison)}"
    if verdict != "better" or not last.ten_second_error_m < first.ten_second_error_m:
        return ""
    ratio = last.ten_second_error_m / first.ten_second_error_m
    return f"the error falls to {100.0 * ratio:.0f} % from {first.name} to {last.name}"


def measures_words(comparison: Comparison, *, most: int | None = None) -> str:
    """Return the measures of the first and the last model, or the first ones, and whether all of them agree.

    A change of the log likelihood is among them if it is significant: one half of a drive, whose fit without an effect
    has almost no noise, can make up all of it.
    """
    agreement = agreement_of(comparison)
    words = [
        f"{one.name} {change:{'+.0f' if abs(change) >= 100.0 else '+.3g'}} nats/m"
        if one.name == "log likelihood"
        else f"{one.name} {size('along', one.before)} -> {size('along', one.after)}"
        for one in agreement.measures
        for change in [one.after - one.before]
        if one.name != "log likelihood" or one.change != "same"
    ] or ["log likelihood"]
    mixed = ": they disagree" if most is None else ", other measures disagree"
    ending = {"mixed": mixed, "worse": ": it is worse", "same": ": no change"}.get(agreement.verdict, "")
    return ", ".join(words[:most]) + ending


def _trajectory_lines(comparison: Comparison) -> list[str]:
    cut = len(comparison.evaluations[0].pieces) > len(comparison.recordings)
    which = "paths, in halves" if cut else "whole paths"
    lines = [f"{which}, each model's effects removed (ATE and RPE as in evo, RMS):"]
    steps: list[tuple[str, TrajectoryError]] = [("odometry, clock corrected", comparison.clock_trajectory)]
    steps += [(j.name, j.trajectory) for j in comparison.evaluations]
    for name, e in steps:
        ate = f"ATE {_metres(e.ate_m)} aligned, {_metres(e.ate_origin_m)} from the same start"
        turn = f"{degrees(e.rpe_rad):.3f} deg" if isfinite(e.rpe_rad) else "-"
        lines += _named(name, f"{ate}; RPE over 1 m {_metres(e.rpe_m)}, {turn}")
    return lines


def _named(name: str, rest: str) -> list[str]:
    """Return a row with its name before it, or above it if long."""
    above = [] if len(name) < _NAME else [f"  {name}"]
    return [*above, f"  {'' if above else name:<{_NAME}}{rest}".rstrip()]


def _metres(value: float) -> str:
    return f"{value:.3f} m" if isfinite(value) else "-"


MOST = 8
"""Largest number of sentences printed per model; JSON has all of them."""
SIGNS = (
    "Signs: odometry minus truth. Plus means that the odometry ends too far ahead, too far left, or turns too far left."
)
_SENSE = {
    "along": ("the odometry ends too far ahead", "the odometry ends too far behind"),
    "across": ("the odometry ends too far left", "the odometry ends too far right"),
    "yaw": ("the odometry turns too far left", "the odometry turns too far right"),
}


def size(channel: str, value: float, *, digits: int = 2, signed: bool = False) -> str:
    """Return a length (m) or angle (rad) in a common unit; a dash if unknown."""
    if not isfinite(value):
        return "–"
    if channel == "yaw":
        return f"{_figures(degrees(value), digits, signed=signed)} deg"
    if abs(value) >= 1.0:
        return f"{_figures(value, digits + 1, signed=signed)} m"
    return f"{_figures(value * 1e3, digits, signed=signed)} mm"


def plainly(value: float) -> str:
    """Return a number to two digits, without an exponent: "170"."""
    return f"{float(f'{value:.2g}'):g}"


def _figures(value: float, digits: int, *, signed: bool) -> str:
    """Return a number with this many figures, in fixed-point notation."""
    if value == 0.0:
        return "0"
    magnitude = int(f"{abs(value):e}".split("e")[1])
    return f"{value:{'+' if signed else ''}.{max(digits - 1 - magnitude, 0)}f}"


def sentence(failure: Failure) -> str:
    """Return a lack of fit as a sentence."""
    tail = f" ({failure.recording})" if failure.recording else ""
    channel, measured, expected = failure.channel, failure.measured, failure.expected
    sense = _SENSE[channel][measured < 0.0]
    if failure.kind == "drift":
        more = "larger" if measured > expected else "smaller"
        return (
            f"{channel} error is {size(channel, measured)} RMS {failure.where}, {more} than the "
            f"{size(channel, expected)} that the model predicts ({failure.amount:g} windows){tail}"
        )
    if failure.kind == "moment":
        return (
            f"{channel} error jumps by {size(channel, measured, signed=True)} {failure.where}: "
            f"{sense}; the model predicts no more than {size(channel, expected)}{tail}"
        )
    per, span = (10.0, "per 10 m") if failure.per == "m" else (60.0, "per minute")
    if failure.amount < per:  # a rate over a longer way than was driven there would be a length that never occurred
        per, span = failure.amount, f"over the {failure.amount:.2g} {'m driven' if failure.per == 'm' else 's'}"
    besides = "on top of the above, " if failure.besides else ""
    return (
        f"{besides}{channel} error grows {size(channel, measured * per, signed=True)} {span} "
        f"{failure.where}: {sense}; the model predicts no more than {size(channel, expected * per)}{tail}"
    )


def evaluation_sentence(evaluation: ModelEvaluation) -> str:
    """Return the verdict on a model."""
    verdict = evaluation.verdict
    count = len(verdict.checks)
    level = f"{100.0 * verdict.level:g} % level, {count} tests together"
    if not verdict.rejected:
        small = "the largest deviations do not reject it" if evaluation.failures else "errors are as predicted"
        return f"{evaluation.name} is not rejected ({level}): {small}"
    if not verdict.fails:
        return f"{evaluation.name} holds in practice: {within(evaluation)}"
    worst = verdict.against[0]
    others = len(verdict.against) - 1
    more = f", and {others} more" if others else ""
    return f"{evaluation.name} is rejected ({level}): {worst.question}, p {_p(worst.p)}{more}"


def rejection(evaluation: ModelEvaluation) -> str:
    """Return the tests that reject a model, the ratio of its errors to the predicted ones, and the reason, or ""."""
    verdict = evaluation.verdict
    if not verdict.rejected:
        return ""
    worst = verdict.against[0]
    said = f"{worst.question}, p {_p(worst.p)}"
    large = [h for h in evaluation.horizons if h.nees > h.nees_bounds[1]]
    small = [h for h in evaluation.horizons if h.nees < h.nees_bounds[0]]
    if large:
        said = f"{said}; {_times(max(large, key=lambda h: h.nees))}"
        return f"{said}: {_remaining(evaluation)}" if verdict.fails else said
    if small:
        return f"{said}; {_times(min(small, key=lambda h: h.nees))}: it predicts more noise than was measured"
    return f"{said}; the size of its errors is as predicted"


def failed_test(evaluation: ModelEvaluation) -> str:
    """Return the test that rejects a model most clearly, with its value and what is expected by chance."""
    verdict = evaluation.verdict
    worst = verdict.against[0]
    sized = next((h for h in evaluation.horizons if size_question(h.distance_m) == worst.question), None)
    if sized is None:
        return f"{worst.question}: p {_p(worst.p)}, below the {verdict.threshold:.2g} that rejects"
    low, high = sized.nees_bounds
    return _times(sized, f", by chance {low:.2f} to {high:.2f}; {sized.windows} windows")


def _remaining(evaluation: ModelEvaluation) -> str:
    """Return possible reasons for errors larger than predicted: the most significant failure decides."""
    worst = min(evaluation.failures, key=lambda failure: failure.log_p, default=None)
    if worst is not None and worst.kind == "moment":
        return f"a single event remains (a push, a slip or a jump of the truth: {worst.where})"
    localised = any(piece.recording.localised for piece in evaluation.pieces)
    return f"{'errors of the localisation, or ' if localised else ''}an effect that is not in the model remains"


def within(evaluation: ModelEvaluation) -> str:
    """Return that a model predicts the sizes of errors, and the test that rejects it nevertheless; "" if none does."""
    verdict = evaluation.verdict
    if not verdict.rejected:
        return ""
    worst = verdict.against[0]
    factor = max(verdict.misfit, 1.0 / max(verdict.misfit, 1e-12))
    largest = max((h.nees**0.5 for h in evaluation.horizons), default=1.0)
    said = f"within {factor:.2f} times the predicted ones" if factor > 1.005 else "as large as the predicted ones"
    if factor < largest > PRACTICAL_FACTOR:
        said = f"up to {largest:.1f} times the predicted ones, which the standard errors of its parameters allow"
    return f"errors are {said}; a difference is significant ({worst.question}, p {_p(worst.p)})"


def reproduction_sentence(one: Reproduction) -> str:
    """Return that a model drifts clearly less or more than its recordings, and the main part of their error; "" if not.

    If it drifts as much, outlying segments excluded by the fit are named if they cause most of the error.
    """
    drifts = f"a truth corrupted with this model has a 10 s error of {size('along', one.drawn_m)}, the recording "
    drifts += size("along", one.measured_m)
    stretches = "1 stretch" if one.outliers == 1 else f"{one.outliers} stretches"
    carry = (
        f"{stretches} ({one.outlier_s:.1f} s) left out of the fit {'makes up' if one.outliers == 1 else 'make up'} "
        f"{100.0 * one.outlier_share:.0f} % of the squared 10 s error"
    )
    if one.too_small:
        why = f"{carry} (slip_burst or push)" if one.by_outliers else "a cause of its drift is not in the model"
        return f"{drifts}: {why}"
    if one.too_large:
        if one.long is not None and one.long.too_large:
            after, drawn, measured = f"{one.long.after_s:.0f} s", one.long.drawn_m, one.long.measured_m
            drifts = f"a truth corrupted with this model has an error of {size('along', drawn)} after a quarter of the "
            drifts += f"drive ({after}), the recording "
            drifts += size("along", measured)
        return f"{drifts}: its noise is too large and may include that of the truth"
    return carry if one.by_outliers else ""


def _times(h: Horizon, more: str = "") -> str:
    said = f"errors over {h.distance_m:g} m of path are {plainly(h.nees**0.5)} times the predicted ones"
    return f"{said} (NEES {h.nees:.2g}{more})"


def _p(p: float) -> str:
    return "< 0.001" if p < 1e-3 else f"{p:.2g}"


def comparison_json(comparison: Comparison) -> dict[str, Any]:
    """Return a comparison as values by name, without the schema."""
    clocks = zip(comparison.recordings, comparison.clocks.clocks, strict=True)
    return {
        "signs": SIGNS,
        **picked(comparison, "recordings"),
        "clocks": [{"recording": name, **picked(clock, "offset_s", skew="rate")} for name, clock in clocks],
        **picked(comparison, raw_ten_second_error_m="raw_error_m", aligned_ten_second_error_m="clock_error_m"),
        "aligned_trajectory": _trajectory(comparison.clock_trajectory),
        "models": [_evaluation(j) for j in comparison.evaluations],
    }


def _evaluation(j: ModelEvaluation) -> dict[str, Any]:
    return {
        **picked(j, "name", "ten_second_error_m", "notes", held_out="judged_on"),
        **picked(j.nats, "gain_error", "blocks", nats_per_m="per_m", nats_per_m_error="error"),
        **picked(j.nats, gain_over_first_nats_per_m="gain_per_m"),
        "verdict": {
            **picked(j.verdict, "rejected", "fails", "misfit", "level", "threshold"),
            "checks": [picked(test, "question", "p") for test in j.verdict.checks],
            "sentence": evaluation_sentence(j),
        },
        "horizons": [_horizon(h) for h in j.horizons],
        "pit": {
            name: picked(pit, "p", "at", "difference", "low", "high", inside_95="inside")
            for name, pit in j.pits.items()
        },
        "whiteness": {name: picked(w, "p", "correlation", ljung_box="statistic") for name, w in j.whiteness.items()},
        "trajectory": _trajectory(j.trajectory),
        "fails": [_failure(f) for f in j.failures],
    }


def _failure(f: Failure) -> dict[str, Any]:
    return {
        **picked(f, "kind", "channel", "where", "measured", "expected", "amount", "log_p", "span_s"),
        "unit": ("rad" if f.channel == "yaw" else "m") + (f"/{f.per}" if f.per else ""),
        "p": math.exp(f.log_p),
        "besides_the_ones_before": f.besides,
        "recording": f.recording or None,
        "place": None if f.place is None else dict(zip(("x_m", "y_m", "radius_m"), f.place, strict=True)),
        "sentence": sentence(f),
    }


def _horizon(h: Horizon) -> dict[str, Any]:
    sized = {name: getattr(h, name) for name in ("measured", "expected", "bias", "crps")}
    plain = {name: getattr(h, name) for name in ("excess_p", "coverage_50", "coverage_90")}
    return {
        **picked(h, "distance_m", "windows", "nees_p", nees_per_dof="nees", nees_95="nees_bounds"),
        **picked(h, position_measured_m="position_measured", position_expected_m="position_expected"),
        **{name: dict(zip(("along_m", "across_m", "yaw_rad"), own, strict=True)) for name, own in sized.items()},
        **{name: dict(zip(("along", "across", "yaw"), own, strict=True)) for name, own in plain.items()},
    }


def _trajectory(e: TrajectoryError) -> dict[str, Any]:
    errors = picked(e, ate_rmse_m="ate_m", ate_origin_rmse_m="ate_origin_m")
    return errors | picked(e, rpe_1m_rmse_m="rpe_m", rpe_1m_rmse_rad="rpe_rad")

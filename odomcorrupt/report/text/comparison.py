"""A comparison as plain text for the terminal."""

from __future__ import annotations

from math import degrees, isfinite
from typing import TYPE_CHECKING

from odomcorrupt.report.text.lack_of_fit import MOST, SIGNS, judgement_sentence, sentence, size
from odomcorrupt.study.validate.agreement import agreement_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from odomcorrupt.study.validate.calibration import Horizon
    from odomcorrupt.study.validate.compare import Comparison, JudgedOn, Judgement
    from odomcorrupt.study.validate.trajectory_error import TrajectoryError

__all__ = ["comparison_text", "falls_sentence", "measures_words", "sequence_steps", "share_of_worst"]

_BAR = 30
_NAME = 24
"""Columns of a model's name; a longer one gets a separate line, so that bars are aligned."""

HELD: dict[JudgedOn, str] = {"recordings": "held out", "halves": "cross-validated", "fitted data": "on the fitted data"}
"""Data on which the errors and likelihoods of a comparison were computed, in words."""
_HOW: dict[JudgedOn, str] = {
    "recordings": "not fitted here",
    "halves": "refitted on the other half of each recording it was fitted on",
    "fitted data": "on the data it was fitted on",
}


def comparison_text(comparison: Comparison) -> str:
    """Return horizons and verdict of every model, the sequence, and each model's lack of fit."""
    lines: list[str] = []
    for judgement in comparison.judgements:
        lines += [f"{judgement.name} ({_HOW[judgement.judged_on]})", *_horizon_lines(judgement.horizons)]
        lines += [f"  note: {note}" for note in judgement.notes]
        lines.append("")
    lines += [*_sequence_lines(comparison), "", *_trajectory_lines(comparison)]
    for judgement in comparison.judgements:
        lines += ["", *failure_lines(judgement)]
    if any(j.failures for j in comparison.judgements):
        lines += ["", SIGNS]
    return "\n".join(lines)


def failure_lines(judgement: Judgement) -> list[str]:
    """Return the verdict, and the model's lack of fit, the most significant first."""
    more = len(judgement.failures) - MOST
    lines = [f"  {number}. {sentence(f)}" for number, f in enumerate(judgement.failures[:MOST], start=1)]
    lines += [f"  and {more} more, see --json"] if more > 0 else []
    return [judgement_sentence(judgement), *(lines or ["  no lack of fit in any motion, time, place or moment"])]


def _horizon_lines(horizons: Sequence[Horizon]) -> list[str]:
    both = "measured (expected)"
    row = "  {:>6}{:>9}{:>23}{:>23}{:>20}{:>8}{:>13}{:>13}{:>13}".format
    lines = [
        row("path", "windows", "along", "across", "yaw", "NEES", "by chance", "in 50 %", "in 90 %"),
        row("", "", both, both, "measured (exp.)", "", "(95 %)", "al/ac/yaw", "al/ac/yaw"),
    ]
    for h in horizons:
        along, across = (f"{_length(h.measured[c])} ({_length(h.expected[c])})" for c in (0, 1))
        yaw = f"{degrees(h.measured[2]):.2f} ({degrees(h.expected[2]):.2f}) deg" if isfinite(h.measured[2]) else "-"
        chance = f"{h.nees_bounds[0]:.2f} to {h.nees_bounds[1]:.2f}"
        outside = " " if h.nees_bounds[0] <= h.nees <= h.nees_bounds[1] else "*"
        lines.append(
            row(
                f"{h.distance_m:g} m", h.windows, along, across, yaw, f"{h.nees:.2f}{outside}", chance,
                _percent(h.coverage_50), _percent(h.coverage_90),
            )
        )  # fmt: skip
    return lines


def _percent(parts: Iterable[float]) -> str:
    return "/".join(f"{100.0 * p:.0f}" if isfinite(p) else "-" for p in parts)


def _length(metres: float) -> str:
    return f"{metres * 1e3:.1f} mm" if metres < 1.0 else f"{metres:.2f} m"


def sequence_steps(comparison: Comparison) -> list[tuple[str, float, Judgement | None]]:
    """Return names and 10 s errors (m), from the measured odometry to the last model."""
    steps: list[tuple[str, float, Judgement | None]] = [("measured odometry", comparison.raw_error_m, None)]
    if comparison.clock_error_m != comparison.raw_error_m:
        steps.append(("with its clock corrected", comparison.clock_error_m, None))
    return [*steps, *((j.name, j.ten_second_error_m, j) for j in comparison.judgements)]


def share_of_worst(steps: Sequence[tuple[str, float, Judgement | None]], error: float) -> float:
    """Return an error relative to the largest of the sequence; 0 if unknown."""
    worst = max((e for _, e, _ in steps if isfinite(e)), default=0.0)
    return error / worst if isfinite(error) and worst > 0.0 else 0.0


def _sequence_lines(comparison: Comparison) -> list[str]:
    steps = sequence_steps(comparison)
    lines = [f"{HELD[comparison.judged_on]} position error (RMS) after 10 s, and log likelihood:"]
    for name, error, judgement in steps:
        bar = "#" * round(_BAR * share_of_worst(steps, error))
        nats = "" if judgement is None else _nats(comparison, judgement)
        size = f"{error * 1e3:9.1f} mm" if isfinite(error) else f"{'-':>12}"
        lines += _named(name, f"{size}  {bar:<{_BAR}}  {nats}")
    falls = falls_sentence(comparison)
    return [*lines, f"  {falls}"] if falls else lines


def _nats(comparison: Comparison, judgement: Judgement) -> str:
    n = judgement.nats
    text = f"{n.per_m:.2f} +- {n.error:.2f} nats/m"
    if judgement is comparison.judgements[0]:
        return text
    return f"{text}  ({n.gain_per_m:+.2f} +- {n.gain_error:.2f} over {comparison.judgements[0].name})"


def falls_sentence(comparison: Comparison) -> str:
    """Return the reduction of the error if no other measure contradicts it, else that the measures disagree.

    "" if the error does not change, or the evaluation is on the fitted data.
    """
    first, last = comparison.judgements[0], comparison.judgements[-1]
    if len(comparison.judgements) < 2 or comparison.judged_on != "recordings":
        return ""
    verdict = agreement_of(comparison).verdict
    if verdict == "mixed":
        return f"from {first.name} to {last.name} {measures_words(comparison)}"
    if verdict != "better" or not last.ten_second_error_m < first.ten_second_error_m:
        return ""
    ratio = last.ten_second_error_m / first.ten_second_error_m
    return f"the error falls to {100.0 * ratio:.0f} % from {first.name} to {last.name}"


def _signed(value: float) -> str:
    """Return a number with its sign and three figures, in fixed-point notation."""
    return f"{value:+.0f}" if abs(value) >= 100.0 else f"{value:+.3g}"


def measures_words(comparison: Comparison) -> str:
    """Return every measure of the first and the last model, and whether they agree."""
    agreement = agreement_of(comparison)
    words = [
        f"{one.name} {_signed(one.after - one.before)} nats/m"
        if one.name == "log likelihood"
        else f"{one.name} {size('along', one.before)} -> {size('along', one.after)}"
        for one in agreement.measures
    ]
    ending = {"mixed": ": they disagree", "worse": ": it is worse", "same": ": no change"}.get(agreement.verdict, "")
    return ", ".join(words) + ending


def _trajectory_lines(comparison: Comparison) -> list[str]:
    cut = len(comparison.judgements[0].pieces) > len(comparison.recordings)
    which = "paths, in halves" if cut else "whole paths"
    lines = [f"{which}, each model's effects taken out (ATE, RPE as evo has them, RMS):"]
    steps: list[tuple[str, TrajectoryError]] = [("odometry, clock corrected", comparison.clock_trajectory)]
    steps += [(j.name, j.trajectory) for j in comparison.judgements]
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

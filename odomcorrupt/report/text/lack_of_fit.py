"""Lack of fit as sentences, for the terminal, the report and JSON."""

from __future__ import annotations

from math import degrees, isfinite
from typing import TYPE_CHECKING

from odomcorrupt.study.validate.goodness_of_fit import PRACTICAL_FACTOR

if TYPE_CHECKING:
    from odomcorrupt.study.validate.calibration import Horizon
    from odomcorrupt.study.validate.compare import Judgement
    from odomcorrupt.study.validate.lack_of_fit import Failure
    from odomcorrupt.study.validate.reproduction import Reproduction

__all__ = ["MOST", "SIGNS", "judgement_sentence", "rejection", "reproduction_sentence", "sentence", "size", "within"]

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
    per, span = (10.0, "10 m") if failure.per == "m" else (60.0, "minute")
    besides = "on top of the above, " if failure.besides else ""
    return (
        f"{besides}{channel} error grows {size(channel, measured * per, signed=True)} per {span} "
        f"{failure.where}: {sense}; the model predicts no more than {size(channel, expected * per)}{tail}"
    )


def judgement_sentence(judgement: Judgement) -> str:
    """Return the verdict on a model."""
    verdict = judgement.verdict
    count = len(verdict.checks)
    level = f"{100.0 * verdict.level:g} % level, {count} tests together"
    if not verdict.rejected:
        small = "the largest deviations do not reject it" if judgement.failures else "errors are as predicted"
        return f"{judgement.name} is not rejected ({level}): {small}"
    if not verdict.fails:
        return f"{judgement.name} holds in practice: {within(judgement)}"
    worst = verdict.against[0]
    others = len(verdict.against) - 1
    more = f", and {others} more" if others else ""
    return f"{judgement.name} is rejected ({level}): {worst.question}, p {_p(worst.p)}{more}"


def rejection(judgement: Judgement) -> str:
    """Return the tests that reject a model, the ratio of its errors to the predicted ones, and the reason, or ""."""
    verdict = judgement.verdict
    if not verdict.rejected:
        return ""
    worst = verdict.against[0]
    said = f"{worst.question}, p {_p(worst.p)}"
    large = [h for h in judgement.horizons if h.nees > h.nees_bounds[1]]
    small = [h for h in judgement.horizons if h.nees < h.nees_bounds[0]]
    if large:
        said = f"{said}; {_times(max(large, key=lambda h: h.nees))}"
        return f"{said}: {_remaining(judgement)}" if verdict.fails else said
    if small:
        return f"{said}; {_times(min(small, key=lambda h: h.nees))}: it predicts more noise than was measured"
    return f"{said}; the size of its errors is as predicted"


def _remaining(judgement: Judgement) -> str:
    """Return possible reasons for errors larger than predicted: the most significant failure decides."""
    worst = min(judgement.failures, key=lambda failure: failure.log_p, default=None)
    if worst is not None and worst.kind == "moment":
        return f"a single event remains (a push, a slip or a jump of the truth: {worst.where})"
    localised = any(piece.recording.localised for piece in judgement.pieces)
    return f"{'errors of the localisation, or ' if localised else ''}an effect that is not in the model remains"


def within(judgement: Judgement) -> str:
    """Return that a model predicts the sizes of errors, and the test that rejects it nevertheless; "" if none does."""
    verdict = judgement.verdict
    if not verdict.rejected:
        return ""
    worst = verdict.against[0]
    factor = max(verdict.misfit, 1.0 / max(verdict.misfit, 1e-12))
    largest = max((h.nees**0.5 for h in judgement.horizons), default=1.0)
    said = f"within {factor:.2f} times the predicted ones" if factor > 1.005 else "as large as the predicted ones"
    if factor < largest > PRACTICAL_FACTOR:
        said = f"up to {largest:.1f} times the predicted ones, which the standard errors of its parameters allow"
    return f"errors are {said}; a difference is significant ({worst.question}, p {_p(worst.p)})"


def reproduction_sentence(one: Reproduction) -> str:
    """Return that a model drifts clearly less or more than its recordings, and the main part of their error; "" if not.

    If it drifts as much, outlying segments excluded by the fit are named if they cause most of the error.
    """
    drifts = f"corrupted with this model 10 s err by {size('along', one.drawn_m)}, recorded by "
    drifts += size("along", one.measured_m)
    stretches = "1 stretch" if one.outliers == 1 else f"{one.outliers} stretches"
    carry = (
        f"{stretches} ({one.outlier_s:.1f} s) left out of the fit {'carries' if one.outliers == 1 else 'carry'} "
        f"{100.0 * one.outlier_share:.0f} % of the squared 10 s error"
    )
    if one.too_small:
        why = f"{carry} (slip_burst or push)" if one.by_outliers else "something that makes it drift is not in it"
        return f"{drifts}: {why}"
    if one.too_large:
        if one.long is not None and one.long.too_large:
            after, drawn, measured = f"{one.long.after_s:.0f} s", one.long.drawn_m, one.long.measured_m
            drifts = f"corrupted with this model {after} err by {size('along', drawn)}, recorded by "
            drifts += size("along", measured)
        return f"{drifts}: its noise is too large, that of the truth may be in it"
    return carry if one.by_outliers else ""


def _times(h: Horizon) -> str:
    return f"errors over {h.distance_m:g} m of path are {h.nees**0.5:.2g} times the predicted ones (NEES {h.nees:.2g})"


def _p(p: float) -> str:
    return "< 0.001" if p < 1e-3 else f"{p:.2g}"

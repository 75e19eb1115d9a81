"""What a search found, as plain text: effects, noise, unexplained dependences, and the smallest detectable sizes."""

from __future__ import annotations

from itertools import pairwise
from math import degrees, isfinite
from typing import TYPE_CHECKING

from odomcorrupt.report.text.confidence import confidence_words, fitted_expression, law_numbers, noise_confidence
from odomcorrupt.report.text.design import advice_text, limits_sentence
from odomcorrupt.report.text.lack_of_fit import rejection, size, within
from odomcorrupt.report.text.tables import clock_lines, noise_text, sequence_text, value_text
from odomcorrupt.study.estimate.clocks import RIVALS
from odomcorrupt.study.estimate.intervals import join
from odomcorrupt.study.estimate.outliers import single_events
from odomcorrupt.study.estimate.random_process import CORRELATED_NOISE
from odomcorrupt.study.estimate.windows import distance_windows, rmse

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from odomcorrupt.report.text.confidence import LawNumber
    from odomcorrupt.study.design.advise import Advice
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.estimate.outliers import Event
    from odomcorrupt.study.select.candidates import Candidate
    from odomcorrupt.study.select.dependence import Dependence
    from odomcorrupt.study.select.heterogeneity import ParameterDifference
    from odomcorrupt.study.select.stepwise import Learned
    from odomcorrupt.study.validate.compare import Judgement

__all__ = ["NOTHING", "contradiction", "dependence", "found_text", "position_error", "shares_text", "unnamed"]

NOTHING = "nothing is missing: no known effect explains more than chance"


def found_text(learned: Learned, advice: Advice, *, judged: Judgement | None = None, fit: Fit | None = None) -> str:
    """Return the findings in order of evidence, what is open, and the smallest detectable sizes.

    judged : the verdict on the final model, where it is known
    fit : the fit of the final model, where it is not the search's own
    """
    lines = clock_lines([r.name for r in learned.fit.problem.recordings], learned.clocks)
    if learned.added:
        lines += ["missing, in the order of evidence, each on top of the ones before:", sequence_text(learned)]
    for gain in learned.noise:
        values = ", ".join(noise_text(gain.effect))
        channel = f" ({gain.effect.channel})" if hasattr(gain.effect, "channel") else ""
        sure = confidence_words(noise_confidence(gain, learned))
        lines.append(f"noise: {gain.effect.name}{channel}, {values} ({sure}): {gain.effect.summary}")
    for unknown in learned.unknown[:3]:
        lines += _unknown_lines(unknown, law_numbers(unknown, learned, fit), fitted=unknown in learned.laws)
    lines += [_event_line(one) for one in single_events(learned.fit)]
    like_a_clock = [name for name in learned.added if name in RIVALS]
    if like_a_clock and learned.clocks.ambiguous_nats > 0.0:
        lines.append(
            f"{' and '.join(like_a_clock)} or a clock that is off: these data do not separate them, because the clock "
            "is significant only without them; give the offset if it is known (--truth-shift), or speed up and brake "
            "hard at two speeds, with turns on the spot between"
        )
    lines += [_disagreement_line(one, learned) for one in learned.disagreements]
    lines += [contradiction(one) for one in learned.contradictions]
    if small := [name for name in learned.added if learned.is_negligible(name)]:
        lines.append(f"negligible, though significant: {', '.join(_moved_words(name, learned) for name in small)}")
    if judged is not None and judged.verdict.fails:
        lines.append(unnamed(rejection(judged), found=bool(lines)))
    elif judged is not None and judged.verdict.rejected:
        lines.append(f"the model holds in practice: {within(judged)}")
    lines = lines or [NOTHING]
    lines += [text for text in (advice_text(advice), limits_sentence(advice.limits)) if text]
    return "\n".join(lines)


def _moved_words(name: str, learned: Learned) -> str:
    span = learned.contributions[name].ten_seconds
    return f"{name} moves {size('along', span.moved_m)} in 10 s, of {size('along', span.error_m)} that remains"


def _event_line(one: Event) -> str:
    """Return when and where something happened once, how large it was, and how to put it into a simulation."""
    moved = ", ".join(
        text
        for text, value, least in (
            (f"{abs(one.along_m) * 1e3:.0f} mm {'back' if one.along_m > 0.0 else 'forwards'}", one.along_m, 1e-3),
            (
                f"{abs(one.across_m) * 1e3:.0f} mm to the {'right' if one.across_m > 0.0 else 'left'}",
                one.across_m,
                1e-3,
            ),
            (
                f"{degrees(abs(one.yaw_rad)):.1f} deg to the {'right' if one.yaw_rad > 0.0 else 'left'}",
                one.yaw_rad,
                2e-3,
            ),
        )
        if abs(value) > least
    )
    lasts_s = max(one.end_s - one.start_s, 1e-3)
    push = ",".join(
        f"{name}={value:.4g}"
        for name, value in (
            ("along", -one.along_m), ("across", -one.across_m), ("yaw", -one.yaw_rad), ("time", one.start_s),
            ("duration", lasts_s),
        )
    )  # fmt: skip
    x, y = one.place_xy
    return (
        f"once, {one.recording} from {one.start_s:.1f} to {one.end_s:.1f} s near ({x:.1f}, {y:.1f}): the robot was "
        f"moved {moved or 'hardly'}, which is not in the odometry (a push, a lift, a bump); left out of the fit. "
        f"To corrupt with it: --effect push:{push}"
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
        "learn from recordings of one state"
    )


def contradiction(one: Candidate) -> str:
    """Return that the data ask for what physics does not allow, and what to check."""
    return (
        f"the data contradict physics: {one.name} would explain {one.score.nats:.0f} nats, but {one.refused}. Look at "
        "how odometry and truth are stamped and integrated, which point the truth follows, and the signs of the axes"
    )


def unnamed(why: str, *, found: bool) -> str:
    """Return the sentence on a rejected model in which no known effect is missing.

    found : whether something was found on the way
    """
    return f"no {'further ' if found else ''}known effect is missing, but the model is rejected: {why}"


def _unknown_lines(unknown: Dependence, numbers: Mapping[str, LawNumber], *, fitted: bool) -> list[str]:
    finding = f"unknown: {dependence(unknown)} ({unknown.nats:.0f} nats), and no known effect explains it"
    spread = ", ".join(f"{name} {value_text(*number)}" for name, number in numbers.items())
    shown = f"{fitted_expression(unknown, numbers)}{f'  ({spread})' if spread else ''}"
    return [finding, f"  {'fitted' if fitted else 'suggested'}: {shown}"]


def dependence(unknown: Dependence) -> str:
    """Return on what an error depends, as a clause."""
    regressor = unknown.regressor.replace("_", " ")
    if unknown.wavelength_m is not None:
        return f"the {unknown.channel} error comes back every {unknown.wavelength_m:.3g} m driven"
    if unknown.wheels:
        whose = "of each wheel" if unknown.wheels == "wheels" else f"of the {unknown.wheels} wheel"
        return f"the error {whose} depends on {regressor}"
    if unknown.name.startswith("twist_"):
        return f"the error of travel and turns alike depends on {regressor}"
    per = {"rad": " per radian turned", "s": " per second"}.get(unknown.per, "")
    return f"the {unknown.channel} error{per} depends on {regressor}"


def shares_text(sequence: Sequence[Judgement]) -> str:
    """Return what each step takes off the held-out error, 10 s, 10 m and 50 m after the truth; "" with one model."""
    lines = ["held-out position error (RMS):"]
    for before, after in pairwise(sequence):
        parts = [_fall("10 s", before.ten_second_error_m, after.ten_second_error_m)]
        parts += [_fall(f"{d:g} m", position_error(before, d), position_error(after, d)) for d in (10.0, 50.0)]
        lines.append(f"  {after.name:<18}{'   '.join(part for part in parts if part)}")
    return "\n".join(lines) if len(sequence) > 1 else ""


def position_error(judgement: Judgement, distance_m: float) -> float:
    """Return the position error (m, RMS) after a length of path; NaN where no stretch is that long."""
    windows = [w for piece in judgement.pieces if len(w := distance_windows(piece.left, distance_m))]
    return rmse(join(windows, [0] * len(windows))) if windows else float("nan")


def _fall(what: str, before: float, after: float) -> str:
    if not (isfinite(before) and isfinite(after) and before > 0.0):
        return ""
    return f"{what}: {size('along', before)} -> {size('along', after)} ({100.0 * (after / before - 1.0):+.0f} %)"

"""Results of a search as plain text: what a person reads in a terminal."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING

from odomcorrupt.effects.effect import amplitudes, choices, parameters
from odomcorrupt.report.text.confidence import clocks_found, confidence_words, step_confidence
from odomcorrupt.study.terms.drive_type import readings_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.estimate.clocks import Clocks
    from odomcorrupt.study.select.candidates import Candidate
    from odomcorrupt.study.select.stepwise import Learned, Step

__all__ = ["candidates_table", "clock_lines", "noise_text", "numbers_text", "sequence_text", "value_text"]


def value_text(value: float, error: float | None, unit: str) -> str:
    """Return a value with its error in common units."""
    if unit.startswith("rad"):
        value, error, unit = degrees(value), None if error is None else degrees(error), "deg" + unit[3:]
    elif unit == "m":
        value, error, unit = value * 1e3, None if error is None else error * 1e3, "mm"
    elif unit == "s" and abs(value) < 1.0:
        value, error, unit = value * 1e3, None if error is None else error * 1e3, "ms"
    elif unit == "":
        value, error, unit = value * 1e2, None if error is None else error * 1e2, "%"
    spread = "" if error is None else f" +- {error:.2g}"
    return f"{value:.4g}{spread} {unit}"


def numbers_text(effect: Effect, errors: Sequence[float]) -> list[str]:
    """Return an effect's numbers in words: amplitudes with their errors, then its shape, places in metres."""
    own = amplitudes(effect)
    shown = zip(own, errors, strict=True)
    sizes = [f"{p.name} {value_text(getattr(effect, p.name), error, p.unit)}" for p, error in shown]
    shapes = [p for p in parameters(effect) if not p.amplitude]
    return sizes + [f"{p.name} {_shape_text(getattr(effect, p.name), p.unit)}" for p in shapes]


def noise_text(effect: Effect) -> list[str]:
    """Return a random effect's numbers in words; a time of zero is none."""
    shown = [p for p in parameters(effect) if p.amplitude or getattr(effect, p.name)]
    return [f"{p.name} {value_text(getattr(effect, p.name), None, p.unit)}" for p in shown]


def _shape_text(value: float, unit: str) -> str:
    """Return a number of a shape; of a place all that lies before the millimetres, however far away the map begins."""
    return f"{round(value, 3):.10g} m" if unit == "m" else value_text(value, None, unit)


def clock_lines(names: Sequence[str], clocks: Clocks) -> list[str]:
    """Return a line for every recording whose clock is off, with its confidence."""
    parts: dict[int, list[str]] = {}
    for one in clocks_found(clocks):
        offset = f"offset {value_text(one.value, one.error, 's')}"
        skew = f"skew {one.value * 1e6:.0f} +- {one.error * 1e6:.2g} ppm"
        said = offset if one.name == "time_offset" else skew
        parts.setdefault(one.recording, []).append(f"{said} ({confidence_words(one.sure)})")
    return [f"{names[i]}: the odometry's clock is off: {', '.join(parts[i])}" for i in sorted(parts)]


def candidates_table(step: Step, *, most: int = 8) -> str:
    """Return the candidates of one step, those with most evidence first."""
    lines = [f"{'effect':<16}{'estimate':<44}{'evidence':>10}{'held out':>16}{'10 s error':>20}"]
    lines += [_candidate_line(c) for c in step.candidates[:most]]
    return "\n".join(lines)


def _candidate_line(candidate: Candidate) -> str:
    score = candidate.score
    values = ", ".join(
        f"{p.name} {value_text(float(v), float(e), p.unit)}" if score.separable else "-"
        for p, v, e in zip(amplitudes(score.effect), score.estimate, score.standard_error, strict=True)
    )
    evidence = f"{candidate.gain:+.1f}" if candidate.fit is not None else f"p {score.p:.2g}"
    held = f"{score.held_out_nats:+.1f} +- {score.held_out_error:.1f}"
    before, after = candidate.rmse
    drift = f"{before * 1e3:.1f} -> {after * 1e3:.1f} mm" if candidate.fit is not None else ""
    refused = f"  ({candidate.refused})" if candidate.refused else ""
    return f"{score.effect.name:<16}{values:<44}{evidence:>10}{held:>16}{drift:>20}{refused}"


def words_text(effect: Effect) -> str:
    """Return those parameters of an effect that are words, and not the usual ones: " (heading gyro)", or ""."""
    said = [
        f"{word} {getattr(effect, word)}"
        for word, (usual, *_) in choices(effect).items()
        if getattr(effect, word) != usual
    ]
    return f" ({', '.join(said)})" if said else ""


def sequence_text(learned: Learned) -> str:
    """Return how the 10 s error of the fitted data fell, step by step."""
    lines, own = [], {effect.name: effect for effect in learned.fit.effects}
    for step in learned.steps:
        if step.added is not None:
            before, after = step.candidates[0].rmse
            twins = readings_of(own[step.added], learned.drive_type)
            others = [name for name in step.alternatives if name not in twins]
            rivals = f" (= {', '.join(twins)}: the same error)" if twins else ""
            rivals += f" (or {', '.join(others)}: these data do not separate them)" if others else ""
            name = step.added + words_text(own[step.added])
            sure = confidence_words(step_confidence(step, learned))
            lines.append(
                f"  + {name:<16}{step.candidates[0].gain:+8.1f} nats   "
                f"{before * 1e3:6.1f} -> {after * 1e3:.1f} mm after 10 s   {sure}{rivals}"
            )
    return "\n".join(lines)

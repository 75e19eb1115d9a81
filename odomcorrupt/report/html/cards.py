"""Findings as cards: name, numbers, confidence, and what the error was before and after."""

from __future__ import annotations

from html import escape
from math import isfinite
from typing import TYPE_CHECKING

from odomcorrupt.effects.effect import amplitudes
from odomcorrupt.report.text.confidence import (
    fitted_expression,
    law_numbers,
    noise_confidence,
    step_confidence,
)
from odomcorrupt.report.text.diagnosis import dependence
from odomcorrupt.report.text.lack_of_fit import size
from odomcorrupt.report.text.tables import clock_lines, noise_text, numbers_text, words_text
from odomcorrupt.study.terms.drive_type import readings_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.select.dependence import Dependence
    from odomcorrupt.study.select.random_effects import RandomCoefficient
    from odomcorrupt.study.select.stepwise import Learned, Step
    from odomcorrupt.study.validate.compare import Comparison

__all__ = ["cards"]


def cards(learned: Learned, sequence: Comparison) -> list[str]:
    """Return a card for everything that was found; nothing where nothing was.

    sequence : the models before and after each addition, judged on held-out data
    """
    errors = iter(learned.fit.standard_errors)
    own = {e.name: (e, [float(next(errors)) for _ in amplitudes(e)]) for e in learned.fit.effects}
    names = [recording.name for recording in learned.fit.problem.recordings]
    found = [_clock(line) for line in clock_lines(names, learned.clocks)]
    found += [_effect(step, learned, *own[step.added], sequence) for step in learned.steps if step.added in own]
    found += [_noise(gain, learned) for gain in learned.noise]
    found += [_unknown(unknown, learned) for unknown in learned.unknown[:3]]
    return [f'<div class="cards">{"".join(found)}</div>'] if found else []


def _card(kind: str, title: str, lines: Sequence[str]) -> str:
    return f'<section class="card {kind}"><h3>{escape(title)}</h3>{"".join(lines).replace("+-", "±")}</section>'


def _clock(line: str) -> str:
    name, _, rest = line.partition(": ")
    return _card(
        "setup", "clock", [f'<p class="value">{escape(rest.rpartition("off: ")[2])}</p>', f"<p>of {escape(name)}</p>"]
    )


def _effect(step: Step, learned: Learned, effect: Effect, errors: Sequence[float], sequence: Comparison) -> str:
    sure = step_confidence(step, learned)
    values = [f'<p class="value">{escape(number)}</p>' for number in numbers_text(effect, errors)]
    lines = [*values, f"<p>{escape(effect.summary)}</p>"]
    if twins := readings_of(effect, learned.drive_type):
        lines.append(f"<p>= {escape(', '.join(twins))}: one error with two readings</p>")
    if rivals := [name for name in step.alternatives if name not in twins]:
        lines.append(f"<p>or {escape(', '.join(rivals))}: these data do not separate them</p>")
    lines += _meter(sure, step.candidates[0].gain)
    names = [judgement.name for judgement in sequence.judgements]
    place = names.index(f"+ {step.added}") if f"+ {step.added}" in names else 0
    if place:
        before, after = (sequence.judgements[i].ten_second_error_m for i in (place - 1, place))
        if isfinite(before) and isfinite(after):
            lines.append(
                f"<p>10 s error {size('along', before)} → <strong>{size('along', after)}</strong>, held out</p>"
            )
    return _card(effect.kind, effect.name + words_text(effect), lines)


def _meter(sure: float, nats: float) -> list[str]:
    return [
        f'<span class="meter"><span style="width:{100.0 * sure:.1f}%"></span></span>',
        f"<p>{100.0 * sure:.1f} % confidence, {nats:.0f} nats</p>",
    ]


def _noise(gain: RandomCoefficient, learned: Learned) -> str:
    values = [f'<p class="value">{escape(number)}</p>' for number in noise_text(gain.effect)]
    channel = f" ({gain.effect.channel})" if hasattr(gain.effect, "channel") else ""
    return _card(
        "noise",
        gain.effect.name + channel,
        [*values, f"<p>noise: {escape(gain.effect.summary)}</p>", *_meter(noise_confidence(gain, learned), gain.nats)],
    )


def _unknown(unknown: Dependence, learned: Learned) -> str:
    expression = fitted_expression(unknown, law_numbers(unknown, learned))
    what = f"{dependence(unknown)} ({unknown.nats:.0f} nats), and no known effect explains it"
    then = "fitted" if unknown in learned.laws else "suggested"
    lines = [f"<p>{escape(what)}; {then}:</p>", f"<p><code>{escape(expression)}</code></p>"]
    return _card("unknown", "unknown", lines)

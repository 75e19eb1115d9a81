"""Report of a search: missing effects, their confidence and gain, and the next drive."""

from __future__ import annotations

from html import escape
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.report.findings import dependences_found, effects_found, foremost, noise_found
from odomcorrupt.report.html.comparison import sequence_table
from odomcorrupt.report.html.explorer import explorer, failure_items, script_hash
from odomcorrupt.report.html.page import page, picture, prose, table
from odomcorrupt.report.plots.comparison import draw_errors, draw_residuals
from odomcorrupt.report.plots.diagnosis import draw_candidates, draw_plan, draw_unknown
from odomcorrupt.report.text.comparison import SIGNS, rejection, size
from odomcorrupt.report.text.design import advice_sentences, drive_sentence, limit_size
from odomcorrupt.report.text.diagnosis import NOTHING, evidence_words, selected_instead, unnamed
from odomcorrupt.report.text.numbers import clock_lines, noise_text, numbers_text, words_text
from odomcorrupt.study.validate.compare import agreement_of

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from odomcorrupt.report.findings import FoundDependence, FoundEffect, FoundNoise
    from odomcorrupt.study.design.advise import Advice
    from odomcorrupt.study.select.result import Learned
    from odomcorrupt.study.validate.compare import Comparison


class SearchReport(NamedTuple):
    """Input of a search's report.

    sequence : models in the order of the search, cross-validated, or the evaluation used instead
    next_command : suggested next command, or ""
    """

    learned: Learned
    sequence: Comparison
    advice: Advice
    next_command: str


def found_html(story: SearchReport, *, version: str) -> str:
    """Return the HTML page."""
    learned, sequence, advice, _ = story
    names = ", ".join(recording.name for recording in learned.fit.problem.recordings)
    title = f"What is missing: {names}"
    body = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="verdict{" rejected" if learned.added or learned.unknown else ""}">{escape(_verdict(story))}.</p>',
        *_cards(learned, sequence),
        "<h2>What to do next</h2>",
        _next(story),
        f"<h2>The error{' falls' if agreement_of(sequence).verdict == 'better' else ''}</h2>",
        sequence_table(sequence),
        *_left(sequence),
        explorer(sequence),
        picture("error", "Error against distance", _ERROR, draw_errors(sequence)),
        picture("candidates", "Candidates", _CANDIDATES, draw_candidates(learned)),
        picture("residuals", "What the error depends on", _RESIDUALS, draw_residuals(sequence)),
    ]
    if learned.unknown:
        body.append(picture("unknown", "What no known effect explains", _UNKNOWN, draw_unknown(learned.unknown)))
    if advice.best is not None:
        caption = f"What to drive: {drive_sentence(advice.best)}. `--drive next.mcap` writes it as /cmd_vel."
        body.append(picture("drive", "The next drive", caption, draw_plan(advice.best)))
    body += [*_detectable(advice), f'<p class="quiet">{escape(_legend(version))}</p>']
    return page(title, body, script_hash=script_hash())


_ERROR = (
    "Errors after a length of path, windows not overlapping and each started at the truth, of the model before each "
    "addition. Dashed: what the model expects. Bars: 90 % interval of the measured value; grey figures: windows."
)
_CANDIDATES = (
    "Log likelihood that each effect would gain, step by step, less what its parameters gain by chance. Dark blue was "
    "added; light blue explains these data as well; grey was refused, with the reason."
)
_RESIDUALS = (
    "Growth of the error per metre driven, odometry minus truth, before and after. Bars that miss zero all along a "
    "curve show on what the error depends; of a right model one in twenty does so by chance."
)
_REJECTED = (
    "The last model is still rejected: predicted errors do not include slowly varying noise or bursts, and there may "
    "be a cause that is not in the library. What the error depends on is drawn below."
)
_UNKNOWN = "Residual error after all effects found are removed, as a curve with two standard errors."


def _verdict(story: SearchReport) -> str:
    learned, parts = story.learned, []
    if names := [_named(one) for one in effects_found(learned) if one.effect.name not in learned.of_setup]:
        parts.append(f"missing: {', then '.join(names)}")
    if learned.noise:
        parts.append(f"noise found: {', '.join(dict.fromkeys(gain.effect.name for gain in learned.noise))}")
    if learned.unknown:
        parts.append(evidence_words(learned.unknown[0]))
    # the sequence contains no noise term: its lack of fit may be due to the noise found
    last = story.sequence.evaluations[-1]
    why = rejection(last) if last.verdict.fails and not (learned.unknown or learned.noise) else ""
    text = "; ".join([*parts, unnamed(why, found=bool(parts))] if why else parts) or NOTHING
    return text[0].upper() + text[1:]


def _named(one: FoundEffect) -> str:
    """Return a name with its aliases, its alternatives after "or", and a note if it is negligible."""
    said = " or ".join([one.names, *one.rivals])
    return f"{said} (negligible)" if one.negligible else said


def _next(story: SearchReport) -> str:
    items = [*advice_sentences(story.advice, selected_instead(story.learned))]
    items += [f"suggested: {u.expression}" for u in story.learned.unknown[:3] if u not in story.learned.laws]
    listed = f"<ul>{''.join(f'<li>{prose(item)}.</li>' for item in items)}</ul>" if items else ""
    command = f"<pre>{escape(story.next_command)}</pre>" if story.next_command else ""
    nothing = "" if listed or command else "<p>There is no open question that another drive would answer.</p>"
    if story.sequence.evaluations[-1].verdict.fails and not story.learned.unknown:
        nothing += f"<p>{_REJECTED}</p>"
    return f'<div class="next">{command}{listed}{nothing}</div>'


def _left(sequence: Comparison) -> list[str]:
    """Return the remaining lack of fit of the last model."""
    last = len(sequence.evaluations) - 1
    if not sequence.evaluations[last].failures:
        return []
    return ["<h2>Where the last model still does not fit</h2>", failure_items(sequence.evaluations[last], last),
            f'<p class="quiet">{escape(SIGNS)}</p>']  # fmt: skip


def _detectable(advice: Advice) -> list[str]:
    """Return the smallest detectable sizes, side by side to save height."""
    if not advice.limits:
        return []
    rows = [[escape(f"{e.effect} {e.parameter}"), escape(limit_size(e))] for e in advice.limits]
    half = -(-len(rows) // 2)
    halves = [table(("effect", "smallest size"), some) for some in (rows[:half], rows[half:]) if some]
    return ["<h2>Smallest detectable sizes</h2>", f'<div class="beside">{"".join(halves)}</div>']


def _legend(version: str) -> str:
    return (
        "Held-out: every model of the sequence was refitted on one half of each recording and evaluated on the other, "
        "both ways. Nats: log likelihood; 10 nats correspond to odds of twenty thousand to one. The detectable "
        f"size is 4.2 standard errors. Made by odomcorrupt {version}."
    )


def _cards(learned: Learned, sequence: Comparison) -> list[str]:
    """Return all findings as cards: name, numbers, confidence, and the error before and after."""
    names = [recording.name for recording in learned.fit.problem.recordings]
    found = [_clock(line) for line in clock_lines(names, learned.clocks)]
    found += [_effect(one, sequence) for one in effects_found(learned)]
    found += [_noise(one) for one in noise_found(learned)]
    found += [_unknown(one) for one in foremost(dependences_found(learned), 3)]
    return [f'<div class="cards">{"".join(found)}</div>'] if found else []


def _card(kind: str, title: str, lines: Sequence[str]) -> str:
    return f'<section class="card {kind}"><h3>{escape(title)}</h3>{"".join(lines).replace("+-", "±")}</section>'


def _clock(line: str) -> str:
    name, _, value = line.partition(": the odometry's clock is off: ")
    return _card("setup", "clock", [f'<p class="value">{escape(value)}</p>', f"<p>of {escape(name)}</p>"])


def _effect(one: FoundEffect, sequence: Comparison) -> str:
    effect = one.effect
    lines = [*_values(numbers_text(effect, one.errors)), f"<p>{escape(effect.summary)}</p>"]
    if one.aliases:
        lines.append(f"<p>= {escape(', '.join(one.aliases))}: one error under two names</p>")
    if one.rivals:
        lines.append(f"<p>or {escape(', '.join(one.rivals))}: these data do not separate them</p>")
    lines += _meter(one.confidence, one.gain_nats)
    for model, extended in pairwise(sequence.evaluations):
        before, after = model.ten_second_error_m, extended.ten_second_error_m
        if extended.name == f"+ {effect.name}" and isfinite(before) and isfinite(after):
            change = f"{size('along', before)} → <strong>{size('along', after)}</strong>"
            lines.append(f"<p>10 s error {change}, held out</p>")
    return _card(effect.kind, effect.name + words_text(effect), lines)


def _values(numbers: Iterable[str]) -> list[str]:
    return [f'<p class="value">{escape(number)}</p>' for number in numbers]


def _meter(probability: float, nats: float) -> list[str]:
    return [
        f'<span class="meter"><span style="width:{100.0 * probability:.1f}%"></span></span>',
        f"<p>{100.0 * probability:.1f} % confidence, {nats:.0f} nats</p>",
    ]


def _noise(one: FoundNoise) -> str:
    lines = [*_values(noise_text(one.effect)), f"<p>noise: {escape(one.effect.summary)}</p>"]
    return _card("noise", one.name, lines + _meter(one.confidence, one.nats))


def _unknown(one: FoundDependence) -> str:
    then = "fitted" if one.fitted else "suggested"
    lines = [f"<p>{escape(evidence_words(one.law))}; {then}:</p>", f"<p><code>{escape(one.expression)}</code></p>"]
    lines += [f"<p>in the model: its mean, {one.mean:.4g}</p>"] if one.mean is not None else []
    return _card("unknown", "unknown", lines)

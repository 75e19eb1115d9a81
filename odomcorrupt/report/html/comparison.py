"""Report of a comparison as one self-contained HTML page, usable offline and printable."""

from __future__ import annotations

from html import escape
from math import isfinite
from typing import TYPE_CHECKING

from odomcorrupt.report.html.explorer import explorer, failure_items, script_hash
from odomcorrupt.report.html.page import page, picture, prose, table
from odomcorrupt.report.plots.comparison import PICTURES
from odomcorrupt.report.text.comparison import (
    MOST,
    SIGNS,
    evaluation_sentence,
    falls_sentence,
    sequence_steps,
    share_of_worst,
    size,
)

if TYPE_CHECKING:
    from odomcorrupt.study.validate.calibration import Horizon
    from odomcorrupt.study.validate.compare import Comparison, ModelEvaluation


def report_html(comparison: Comparison, *, version: str) -> str:
    """Return the HTML page."""
    title = f"Odometry against truth: {', '.join(comparison.recordings)}"
    body = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="quiet">{escape(_models_line(comparison))}</p>',
        "<h2>In words</h2>",
        *_words(comparison),
        "<h2>Side by side</h2>",
        sequence_table(comparison),
        explorer(comparison),
        *(picture(name, p.title, p.caption, p.draw(comparison)) for name, p in PICTURES.items()),
        "<h2>Numbers</h2>",
        *(f'<div data-model="{i}">{_horizon_table(j)}</div>' for i, j in enumerate(comparison.evaluations)),
        f'<p class="quiet">{escape(_legend(version))}</p>',
    ]
    return page(title, body, script_hash=script_hash())


def _models_line(comparison: Comparison) -> str:
    names = ", ".join(j.name for j in comparison.evaluations)
    if comparison.judged_on == "fitted data":
        return f"Models: {names}. Evaluation on the data that they were fitted on, too short for halves."
    if comparison.judged_on == "folds":
        return f"Models: {names}. Fitted on these recordings: refitted without each part of them and evaluated on it."
    return f"Models: {names}. Evaluation on recordings that they were not fitted on."


def _words(comparison: Comparison) -> list[str]:
    parts = []
    falls = falls_sentence(comparison)
    if falls:
        parts.append(
            f"<p><strong>{escape(falls[0].upper() + falls[1:])}</strong> (position, 10 s after the truth).</p>"
        )
    for number, evaluation in enumerate(comparison.evaluations):
        mark = "verdict rejected" if evaluation.verdict.fails else "verdict"
        parts.append(f"<h3>{escape(evaluation.name)}</h3>")
        parts.append(f'<p class="{mark}">{escape(evaluation_sentence(evaluation))}.</p>')
        if evaluation.failures:
            parts.append(failure_items(evaluation, number))
            more = len(evaluation.failures) - MOST
            parts += (
                [f'<p class="quiet">And {more} more, less significant; --json has them all.</p>'] if more > 0 else []
            )
        else:
            parts.append("<p>No motion, time, place or moment in which it fails.</p>")
        parts += [f'<p class="quiet">Note: {prose(note)}.</p>' for note in evaluation.notes]
    parts.append(f'<p class="quiet">{escape(SIGNS)}</p>')
    return parts


def sequence_table(comparison: Comparison) -> str:
    """Return a table of errors, nats and verdict of every model in the sequence, with bars for the errors."""
    steps = sequence_steps(comparison)
    rows = []
    for name, error, evaluation in steps:
        width = 6.0 * share_of_worst(steps, error)
        cells = [
            escape(name),
            size("along", error, digits=3),
            f'<span class="bar" style="width:{width:.2f}rem"></span>',
        ]
        if evaluation is None:
            cells += ["", "", "", "", ""]
        else:
            n, e = evaluation.nats, evaluation.trajectory
            first = evaluation is comparison.evaluations[0]
            cells += [
                f"{n.per_m:.2f} ± {n.error:.2f}",
                "" if first else f"{n.gain_per_m:+.2f} ± {n.gain_error:.2f}",
                _known("along", e.ate_m),
                f"{_known('along', e.rpe_m)}, {_known('yaw', e.rpe_rad)}",
                "rejected" if evaluation.verdict.fails else "not rejected",
            ]
        rows.append(cells)
    heads = (
        "", "error after 10 s", "", "nats per metre", f"gain over {comparison.evaluations[0].name}", "ATE, aligned",
        "RPE over 1 m", "verdict",
    )  # fmt: skip
    return table(heads, rows)


def _horizon_table(evaluation: ModelEvaluation) -> str:
    heads = ("path", "windows", "along (expected)", "across (expected)", "yaw (expected)", "NEES", "95 % by chance",
             "in 50 %", "in 90 %", "CRPS along, across, yaw")  # fmt: skip
    return table(heads, [_horizon_row(h) for h in evaluation.horizons], evaluation.name)


def _horizon_row(h: Horizon) -> list[str]:
    channels = ("along", "across", "yaw")
    errors = [
        f"{_known(c, h.measured[i])} ({_known(c, h.expected[i])})" if isfinite(h.measured[i]) else "–"
        for i, c in enumerate(channels)
    ]
    low, high = h.nees_bounds
    inside = [
        "/".join(f"{100.0 * p:.0f}" if isfinite(p) else "–" for p in part) + " %"
        for part in (h.coverage_50, h.coverage_90)
    ]
    crps = ", ".join(_known(c, h.crps[i]) for i, c in enumerate(channels))
    nees = f"{h.nees:.2f}" if low <= h.nees <= high else f"!{h.nees:.2f}"
    return [f"{h.distance_m:g} m", str(h.windows), *errors, nees, f"{low:.2f} to {high:.2f}", *inside, crps]


def _known(channel: str, value: float) -> str:
    return size(channel, float(value), digits=3)


def _legend(version: str) -> str:
    return (
        "Windows of a length of path do not overlap and start at the truth. Errors are root mean squares, in the frame "
        "of the window's end. NEES: normalised squared error per degree of freedom, 1 where the model is right; its "
        "95 % range by chance includes the standard errors of the model. 50 and 90 %: part of the errors inside the "
        "model's intervals. CRPS: the smaller, the better. ATE and RPE as evo defines them, root mean squares. Nats: "
        f"log likelihood of measurements that were not fitted. Made by odomcorrupt {version}."
    )

"""Reports of a comparison, a search and a score as self-contained HTML pages, usable offline and printable."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass
from hashlib import sha256
from html import escape
from importlib.resources import files
from itertools import pairwise
from math import isfinite
from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt import __version__
from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.se2 import between, compose
from odomcorrupt.report import comparison as comparisons
from odomcorrupt.report import findings as texts
from odomcorrupt.report import score as scores
from odomcorrupt.report.plots.comparison import (
    PICTURES,
    draw_candidates,
    draw_errors,
    draw_plan,
    draw_residuals,
    draw_unknown,
    rms_interval,
)
from odomcorrupt.report.plots.figure import rendered
from odomcorrupt.report.plots.score import along, draw_alone, drift, places
from odomcorrupt.scoring.gate import quantity
from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.validate.calibration import HORIZONS_M
from odomcorrupt.study.validate.compare import agreement_of
from odomcorrupt.study.validate.lack_of_fit import CHANNELS, all_patterns, interval_motion
from odomcorrupt.study.validate.predictive_check import replay

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from matplotlib.figure import Figure
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.report.findings import Found
    from odomcorrupt.scoring.gate import Verdict
    from odomcorrupt.scoring.run import ScoreReport
    from odomcorrupt.study.design.advise import Advice
    from odomcorrupt.study.select.result import Learned
    from odomcorrupt.study.validate.compare import Comparison, JudgedOn, ModelEvaluation
    from odomcorrupt.study.validate.evaluation import Evaluation
    from odomcorrupt.study.validate.lack_of_fit import Failure
    from odomcorrupt.summary import Summary


_POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
"""Content security policy: the browser may load nothing but the page itself."""
_STYLE, SCRIPT = (
    files("odomcorrupt.report.html").joinpath(name).read_text(encoding="utf-8") for name in ("page.css", "explorer.js")
)


def page(title: str, body: Sequence[str], legend: str) -> str:
    """Return a whole page with the given elements in its body, and a legend below them.

    The browser may run no script but that of the explorer.
    """
    allowed = f"sha256-{base64.b64encode(sha256(SCRIPT.encode()).digest()).decode()}"
    elements = "\n".join(body)
    return f"""<!DOCTYPE html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="{_POLICY}; script-src '{allowed}'">
<meta name="viewport" content="width=device-width, initial-scale=1">
<title>{escape(title)}</title>
<link rel="icon" href="data:,">
<style>
{_STYLE}</style>
</head>
<body>
{elements}
<p class="quiet">{escape(legend)} Made by odomcorrupt {__version__}.</p>
</body>
</html>
"""


def prose(text: str) -> str:
    """Return a sentence as HTML; text between backticks is code."""
    parts = escape(text).split("`")
    if len(parts) % 2 == 0:
        return escape(text)
    return "".join(f"<code>{part}</code>" if i % 2 else part for i, part in enumerate(parts))


def picture(name: str, title: str, caption: str, figure: Figure) -> str:
    """Return a heading and a figure, with a name for links: vectors, or pixels if the vectors are too large."""
    kind, data = "svg+xml", rendered(figure, "svg")
    # a figure with embedded pixels would not become smaller
    # size of a vector figure, bytes, above which it is rasterised if that is smaller; keeps the page below 3 MB
    if len(data) > 600_000 and b"data:image/png" not in data:
        pixels = rendered(figure, "png")
        kind, data = ("png", pixels) if len(pixels) < len(data) else (kind, data)
    url = f"data:image/{kind};base64,{base64.b64encode(data).decode()}"
    return (
        f'<h2>{escape(title)}</h2><figure id="{name}"><figcaption>{prose(caption)}</figcaption>'
        f'<img src="{url}" alt="{escape(title)}: {escape(caption)}"></figure>'
    )


def table(heads: Sequence[str], rows: Sequence[Sequence[str]], caption: str = "") -> str:
    """Return a table; a cell that begins with ! is highlighted."""
    top = "".join(f'<th scope="col">{escape(head)}</th>' for head in heads)
    lines = [
        "".join(f'<td class="off">{c[1:]}</td>' if c.startswith("!") else f"<td>{c}</td>" for c in row) for row in rows
    ]
    body = "".join(f"<tr>{line}</tr>" for line in lines)
    title = f"<caption>{escape(caption)}</caption>" if caption else ""
    return f'<div class="scroll"><table>{title}<thead><tr>{top}</tr></thead><tbody>{body}</tbody></table></div>'


_SIGNS = f'<p class="quiet">{escape(comparisons.SIGNS)}</p>'


def score_html(report: ScoreReport, verdicts: Sequence[Verdict]) -> str:
    """Return the HTML page."""
    title = f"Localisation under drift: {report.estimate}, {len(report.runs)} runs"
    first, *rest = scores.sentences(report)
    sections = [
        [f"{s.from_m:.1f} to {s.to_m:.1f} m", f"{s.xy_m[0]:.2f}, {s.xy_m[1]:.2f}", str(s.runs),
         quantity("_m", s.median_m), quantity("_m", s.p90_m), f"!{s.failures}" if s.failures else "0"]
        for s in report.sections
    ]  # fmt: skip
    point_rows, metric_rows = (
        [list(map(escape, row)) for row in rows] for rows in (scores.point_rows(report), scores.metric_rows(report))
    )
    runs = []
    # largest number of runs in the table; the worst ones are listed
    for run in sorted(report.runs, key=lambda run: -run.metrics.get("ate_m", float("inf")))[:1000]:
        *cells, status = map(escape, scores.run_cells(run))
        runs.append([*cells, status if run.status == "ok" else f"!{status}"])
    body = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="quiet">Truth: {escape(report.truth)}. Alignment: {escape(report.align)}.</p>',
        *(f'<p class="verdict{" rejected" if v.failed else ""}">{"<br>".join(map(escape, scores.gate_lines([v])))}</p>'
          for v in verdicts),
        f"<p><strong>{escape(first)}</strong></p>",
        *(f"<p>{escape(sentence)}</p>" for sentence in rest),
        picture(
            "drift", "Error against drift", "One mark per run. Line: the drift at which 5 % of runs are lost, band: "
            "its 95 % interval.", draw_alone(drift, report, 8.0, 4.2),
        ),
        picture(
            "along", "Error along the path", "Position error of each run over the way driven; lost runs are orange.",
            draw_alone(along, report, 8.0, 4.2),
        ),
        picture("places", "Where it fails", "Crosses: where runs were lost.", draw_alone(places, report, 7.0, 6.0)),
        table(scores.POINT_HEADS, point_rows) if len(report.points) > 1 else "",
        "<h2>Over runs</h2>",
        table(scores.METRIC_HEADS, metric_rows),
        table(_SECTION_HEADS, sections, "Along the path"),
        "<h2>Runs</h2>",
        table(scores.RUN_HEADS, runs, "The worst first"),
        *(f'<p class="quiet">Note: {escape(note)}.</p>' for note in report.notes),
    ]  # fmt: skip
    return page(title, body, _SCORE_LEGEND.format(report.limits))


_SECTION_HEADS = ("along the path", "x, y (m)", "runs", "median error", "p90", "losses begin")
_SCORE_LEGEND = (
    "ATE and RPE as evo defines them (root mean squares, the truth interpolated at the stamps of the estimate). "
    "Lost: more than {0.lost_m:g} m off for {0.lost_s:g} s or until the end; diverged: ten times that far. Jump: the "
    "error changes by {0.jump_m:g} m within a second. Intervals of quantiles by order statistics, of the break-down "
    "point by profile likelihood of a logistic regression on the logarithm of the drift."
)


_EVALUATED: dict[JudgedOn, str] = {
    "fitted data": "Evaluation on the data that they were fitted on, too short for halves.",
    "folds": "Fitted on these recordings: refitted without each part of them and evaluated on it.",
    "recordings": "Evaluation on recordings that they were not fitted on.",
}
_RUNS, _RUN_POINTS, _RUN_STRETCHES = 20, 200, 8
"""Runs of a model drawn around the truth, points per run, and number of pairs of model and segment with runs."""


def explorer(comparison: Comparison) -> str:
    """Return the section of the page: an empty frame, its data and its script."""
    stretches = _stretches(comparison)
    with_runs = _RUN_STRETCHES // len(comparison.evaluations) or 1
    data = {
        "lengths": sorted({h.distance_m for j in comparison.evaluations for h in j.horizons}),
        "pieces": [_stretch(stretch, comparison) for stretch in stretches],
        "models": [_model(evaluation, stretches, with_runs) for evaluation in comparison.evaluations],
    }
    content = json.dumps(data, allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")
    return (
        '<h2>Explore</h2><noscript><p class="quiet">With JavaScript enabled, path, residuals and errors can be '
        "explored here; the text and figures below do not need it.</p></noscript>"
        '<div id="explorer" hidden></div>'
        f'<script type="application/json" id="explorer-data">{content}</script>'
        f"<script>{SCRIPT}</script>"
    )


def failure_items(evaluation: ModelEvaluation, number: int) -> str:
    """Return a model's lacks of fit as a list; the script highlights each of them on path and residuals."""
    items = (
        f'<li data-look="{number},{i}">{escape(comparisons.sentence(failure))}</li>'
        for i, failure in enumerate(evaluation.failures[: comparisons.MOST])
    )
    return f"<ol>{''.join(items)}</ol>"


@dataclass(frozen=True, slots=True)
class _Stretch:
    """One segment, and the intervals (k,) of it that are drawn.

    number : index among the pieces of an evaluation
    reference : evaluation under the first model, the source of times, truth and odometry
    start : (k,) index of the first interval that each drawn point represents
    """

    number: int
    reference: Evaluation
    start: NDArray[np.int64]

    @property
    def times_s(self) -> Array:
        intervals = self.reference.problem.intervals
        return intervals.start_s[self.start]

    @property
    def truth_xyt(self) -> Array:
        return self.reference.problem.intervals.truth_xyt[self.start]


def _stretches(comparison: Comparison) -> list[_Stretch]:
    """Return the longest segments, in descending order, each with as many points as fit in the page."""
    pieces = comparison.evaluations[0].pieces
    # number of segments that can be selected, the longest ones
    longest = sorted(range(len(pieces)), key=lambda i: -float(pieces[i].interval_metres.sum()))[:8]
    # total number of points, of all segments under all models; keeps the page below 3 MB
    most = max(7000 // (len(longest) * (1 + len(comparison.evaluations))), 50)
    found = []
    for number in longest:
        count = len(pieces[number].problem.intervals)
        start = np.unique(np.linspace(0, count - 1, min(count, most)).astype(np.int64))
        found.append(_Stretch(number, pieces[number], start))
    return found


def _stretch(stretch: _Stretch, comparison: Comparison) -> dict[str, Any]:
    """Return times, truth and odometry of a segment, with the odometry aligned to the truth at the first pose."""
    piece, start = stretch.reference, stretch.start
    motion = interval_motion(piece.problem)
    driven = np.concatenate(([0.0], np.cumsum(piece.interval_metres)[:-1]))
    linked = piece.problem.intervals.linked
    breaks = [i for i in range(1, len(start)) if not linked[start[i - 1] + 1 : start[i] + 1].all()]
    recorded = undo(piece.recording, piece.model.setup.effects).odometry
    return {
        "name": piece.recording.name if len(comparison.recordings) > 1 else f"from {stretch.times_s[0]:.0f} s",
        "length_m": round(float(piece.interval_metres.sum())),
        "t": _rounded(stretch.times_s, 2),
        "d": _rounded(driven[start], 2),
        "v": _rounded(motion.v[start], 3),
        "w": _rounded(motion.omega[start], 4),
        "gaps": breaks,
        "truth": _poses(stretch.truth_xyt),
        "measured": _poses(_in_truth(stretch, recorded.at(stretch.times_s, piece.recording.origin_ns))),
    }


def _in_truth(stretch: _Stretch, poses: Array) -> Array:
    """Return poses (k, 3) of an odometry, aligned with the truth at the first pose."""
    return compose(stretch.truth_xyt[0], between(poses[0], poses))


def _model(evaluation: ModelEvaluation, stretches: list[_Stretch], with_runs: int) -> dict[str, Any]:
    return {
        "name": evaluation.name,
        "pieces": [
            _under_model(evaluation.pieces[stretch.number], stretch, runs=i < with_runs)
            for i, stretch in enumerate(stretches)
        ],
        "horizons": [
            {
                "length": h.distance_m, "windows": h.windows, "measured": h.position_measured,
                "expected": h.position_expected, "nees": h.nees, "low": low, "high": high,
            }
            for h in evaluation.horizons if h.distance_m in HORIZONS_M
            for low, high in [rms_interval(h.position_measured, h.windows)]
        ],
        "failures": [_failure(failure, evaluation, stretches) for failure in evaluation.failures[:comparisons.MOST]],
    }  # fmt: skip


def _under_model(piece: Evaluation, stretch: _Stretch, *, runs: bool) -> dict[str, Any]:
    """Return odometry without the model's effects, residuals summed along the drive, and runs of the model."""
    intervals, times_s = piece.problem.intervals, stretch.times_s
    left = piece.left.odometry.at(times_s, piece.recording.origin_ns)
    until = np.searchsorted(intervals.end_s, times_s + 1e-6)
    summed = np.concatenate((np.zeros((1, 3)), np.cumsum(intervals.residual, axis=0)))[until]
    count = 3 if piece.headed else 2
    size = np.sqrt(np.mean(piece.innovations.reshape(-1, 3)[:, :count] ** 2, axis=1))
    first = np.minimum(until, len(size) - 1)
    # of the intervals that a point represents, the one with the largest residual
    ends = np.append(first[1:], len(size))
    worst = [float(size[a : max(b, a + 1)].max()) for a, b in zip(first, ends, strict=True)]
    yaw = _rounded(np.degrees(summed[:, 2]), 3) if piece.headed else [None] * len(times_s)
    return {
        "corrected": _poses(_in_truth(stretch, left)),
        "residuals": [_rounded(summed[:, 0], 4), _rounded(summed[:, 1], 4), yaw, _rounded(np.array(worst), 2)],
        "runs": _runs(piece) if runs else [],
    }


def _runs(piece: Evaluation) -> list[list[list[float]]]:
    try:
        paths = replay(piece, runs=_RUNS)
    except EffectError:  # effects that contradict the odometry of this drive have no runs
        return []
    kept = np.unique(np.linspace(0, len(paths.truth_xyt) - 1, _RUN_POINTS).astype(np.int64))
    return [[_rounded(run[kept, 0], 3), _rounded(run[kept, 1], 3)] for run in paths.runs_xyt]


def _failure(failure: Failure, evaluation: ModelEvaluation, stretches: list[_Stretch]) -> dict[str, Any]:
    """Return the extent of a lack of fit: spans (segment, first point, last point), or the path length of a drift."""
    spans = []
    for i, stretch in enumerate(stretches):
        piece = evaluation.pieces[stretch.number]
        if failure.recording in ("", piece.recording.name):
            inside = np.concatenate(([0], _holds(failure, piece, stretch).astype(np.int8), [0]))
            edges = np.flatnonzero(np.diff(inside)).tolist()  # beginnings and ends of runs of points
            spans += [[i, a, b - 1] for a, b in zip(edges[::2], edges[1::2], strict=True)]
    length = float(failure.where.split()[1]) if failure.kind == "drift" else None
    place = [round(value, 3) for value in failure.place] if failure.place is not None else None
    return {"channel": CHANNELS.index(failure.channel), "spans": spans, "place": place, "length": length}


def _holds(failure: Failure, piece: Evaluation, stretch: _Stretch) -> NDArray[np.bool_]:
    """Return the points (k,) of a segment with a lack of fit; a drift accumulates everywhere and is at none of them."""
    intervals = piece.problem.intervals
    if failure.kind == "drift":
        return np.zeros(len(stretch.start), dtype=np.bool_)
    if failure.span_s is not None:
        inside = (intervals.end_s > failure.span_s[0]) & (intervals.start_s < failure.span_s[1])
    elif failure.place is not None:
        x, y, radius = failure.place
        inside = np.hypot(intervals.truth_xyt[:, 0] - x, intervals.truth_xyt[:, 1] - y) < radius
    else:
        masks = [p.mask > 0.0 for p in all_patterns(interval_motion(piece.problem)) if p.where == failure.where]
        inside = masks[0] if masks else np.zeros(len(intervals), dtype=np.bool_)
    # a point represents all intervals until the next one
    owner = np.searchsorted(stretch.times_s, intervals.start_s + 1e-6) - 1
    found = np.zeros(len(stretch.start), dtype=np.bool_)
    found[np.clip(owner[inside], 0, len(found) - 1)] = True
    return found


def _poses(xyt: Array) -> dict[str, list[float]]:
    return {"x": _rounded(xyt[:, 0], 3), "y": _rounded(xyt[:, 1], 3), "yaw": _rounded(xyt[:, 2], 4)}


def _rounded(values: Array, places: int) -> list[float]:
    return np.round(values, places).tolist()


def report_html(comparison: Comparison) -> str:
    """Return the HTML page."""
    title = f"Odometry against truth: {', '.join(comparison.recordings)}"
    names = ", ".join(j.name for j in comparison.evaluations)
    body = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="quiet">Models: {escape(names)}. {_EVALUATED[comparison.judged_on]}</p>',
        "<h2>In words</h2>",
        *_words(comparison),
        "<h2>Side by side</h2>",
        sequence_table(comparison),
        explorer(comparison),
        *(picture(name, p.title, p.caption, p.draw(comparison)) for name, p in PICTURES.items()),
        "<h2>Numbers</h2>",
        *(f'<div data-model="{i}">{_horizon_table(j)}</div>' for i, j in enumerate(comparison.evaluations)),
    ]
    return page(title, body, _COMPARISON_LEGEND)


def _words(comparison: Comparison) -> list[str]:
    parts = []
    falls = comparisons.falls_sentence(comparison)
    if falls:
        parts.append(
            f"<p><strong>{escape(falls[0].upper() + falls[1:])}</strong> (position, 10 s after the truth).</p>"
        )
    for number, evaluation in enumerate(comparison.evaluations):
        mark = "verdict rejected" if evaluation.verdict.fails else "verdict"
        parts.append(f"<h3>{escape(evaluation.name)}</h3>")
        parts.append(f'<p class="{mark}">{escape(comparisons.evaluation_sentence(evaluation))}.</p>')
        if evaluation.failures:
            parts.append(failure_items(evaluation, number))
            more = len(evaluation.failures) - comparisons.MOST
            if more > 0:
                parts.append(f'<p class="quiet">And {more} more, less significant; --json has them all.</p>')
        else:
            parts.append("<p>No motion, time, place or moment in which it fails.</p>")
        parts += [f'<p class="quiet">Note: {prose(note)}.</p>' for note in evaluation.notes]
    parts.append(_SIGNS)
    return parts


def sequence_table(comparison: Comparison) -> str:
    """Return a table of errors, nats and verdict of every model in the sequence, with bars for the errors."""
    steps = comparisons.sequence_steps(comparison)
    rows = []
    for name, error, evaluation in steps:
        width = 6.0 * comparisons.share_of_worst(steps, error)
        cells = [
            escape(name),
            comparisons.size("along", error, digits=3),
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
    rows = []
    for h in evaluation.horizons:
        *cells, nees, chance, half, most = comparisons.horizon_cells(h)
        mark = "" if h.nees_bounds[0] <= h.nees <= h.nees_bounds[1] else "!"
        crps = ", ".join(_known(channel, value) for channel, value in zip(CHANNELS, h.crps, strict=True))
        rows.append([*cells, mark + nees, chance, half, most, crps])
    return table(heads, rows, evaluation.name)


def _known(channel: str, value: float) -> str:
    return comparisons.size(channel, float(value), digits=3)


_COMPARISON_LEGEND = (
    "Windows of a length of path do not overlap and start at the truth. Errors are root mean squares, in the frame of "
    "the window's end. NEES: normalised squared error per degree of freedom, 1 where the model is right; its 95 % "
    "range by chance includes the standard errors of the model. 50 and 90 %: part of the errors inside the model's "
    "intervals. CRPS: the smaller, the better. ATE and RPE as evo defines them, root mean squares. Nats: log "
    "likelihood of measurements that were not fitted."
)


def found_html(learned: Learned, sequence: Comparison, advice: Advice, following: str, summary: Summary) -> str:
    """Return the HTML page of a search.

    sequence : models in the order of the search, cross-validated, or the evaluation used instead
    following, summary : suggested next command, or "", and lines "change" that say what to set in the robot
    """
    names = [recording.name for recording in learned.fit.problem.recordings]
    title = ", evaluated on ".join([", ".join(names), *(name for name in sequence.recordings if name not in names)])
    mark = " rejected" if learned.added or learned.unknown else ""
    last, left = len(sequence.evaluations) - 1, []
    if sequence.evaluations[last].failures:
        items = failure_items(sequence.evaluations[last], last)
        left = [
            "<h2>Where the last model still does not fit</h2>",
            items,
            f'<p class="quiet">{escape(comparisons.SIGNS)}</p>',
        ]
    body = [
        f"<h1>What is missing: {escape(title)}</h1>",
        f'<p class="verdict{mark}">{escape(_verdict(learned, sequence))}</p>',
        *_cards(learned, sequence),
        "<h2>What to do next</h2>",
        *(f"<p>{escape(line.text)}.</p>" for line in summary.lines if line.label == "change"),
        _next(learned, sequence, advice, following),
        f"<h2>The error{' falls' if agreement_of(sequence).verdict == 'better' else ''}</h2>",
        sequence_table(sequence),
        *left,
        explorer(sequence),
        picture("error", "Error against distance", _ERROR, draw_errors(sequence)),
        picture("candidates", "Candidates", _CANDIDATES, draw_candidates(learned)),
        picture("residuals", "What the error depends on", _RESIDUALS, draw_residuals(sequence)),
    ]
    if learned.unknown:
        body.append(picture("unknown", "What no known effect explains", _UNKNOWN, draw_unknown(learned.unknown)))
    if advice.best is not None:
        caption = f"What to drive: {texts.drive_sentence(advice.best)}. `--drive next.mcap` writes it as /cmd_vel."
        body.append(picture("drive", "The next drive", caption, draw_plan(advice.best)))
    if advice.limits:  # side by side, to save height
        rows = [[escape(f"{e.effect} {e.parameter}"), escape(texts.limit_size(e))] for e in advice.limits]
        half = -(-len(rows) // 2)
        halves = [table(("effect", "smallest size"), some) for some in (rows[:half], rows[half:]) if some]
        body += ["<h2>Smallest detectable sizes</h2>", f'<div class="beside">{"".join(halves)}</div>']
    return page(f"What is missing: {title}", body, _SEARCH_LEGEND)


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
_UNKNOWN = (
    "Truth minus odometry as a curve that is fitted together with the effects found, with two standard errors. A "
    "constant may be in the curve or in one of these effects: its shape counts, not its level."
)


def _verdict(learned: Learned, sequence: Comparison) -> str:
    parts = []
    found = [one for one in texts.effects_found(learned) if one.effect.name not in learned.of_setup]
    if names := [" or ".join([one.names, *one.rivals]) + " (negligible)" * one.negligible for one in found]:
        parts.append(f"missing: {', then '.join(names)}")
    if learned.noise:
        parts.append(f"noise found: {', '.join(dict.fromkeys(gain.effect.name for gain in learned.noise))}")
    if learned.unknown:
        parts.append(texts.evidence_words(learned.unknown[0]))
    # the sequence contains no noise term: its lack of fit may be due to the noise found
    last = sequence.evaluations[-1]
    why = comparisons.rejection(last) if last.verdict.fails and not (learned.unknown or learned.noise) else ""
    text = "; ".join([*parts, texts.unnamed(why, found=bool(parts))] if why else parts) or texts.NOTHING
    return f"{text[0].upper()}{text[1:]}."


def _next(learned: Learned, sequence: Comparison, advice: Advice, following: str) -> str:
    items = [*texts.advice_sentences(advice, texts.selected_instead(learned))]
    items += [f"suggested: {u.expression}" for u in learned.unknown[:3] if u not in learned.laws]
    listed = f"<ul>{''.join(f'<li>{prose(item)}.</li>' for item in items)}</ul>" if items else ""
    command = f"<pre>{escape(following)}</pre>" if following else ""
    nothing = "" if listed or command else "<p>There is no open question that another drive would answer.</p>"
    if sequence.evaluations[-1].verdict.fails and not learned.unknown:
        nothing += f"<p>{_REJECTED}</p>"
    return f'<div class="next">{command}{listed}{nothing}</div>'


_SEARCH_LEGEND = (
    "Held-out: on data that a model was not fitted to, other recordings or the other half of the only one. Nats: log "
    "likelihood; 10 nats are odds of twenty thousand to one. The detectable size is 4.2 standard errors."
)


def _cards(learned: Learned, sequence: Comparison) -> list[str]:
    """Return all findings as cards: name, numbers, confidence, and the error before and after."""
    names = [recording.name for recording in learned.fit.problem.recordings]
    found = []
    for line in texts.clock_lines(names, learned.clocks):
        name, _, value = line.partition(": the odometry's clock is off: ")
        found.append(_card("setup", "clock", [*_values([value]), f"<p>of {escape(name)}</p>"]))
    found += [_effect(one, sequence) for one in (*texts.effects_found(learned), *texts.noise_found(learned))]
    for unknown in texts.foremost(texts.dependences_found(learned), 3):
        said = f"{texts.evidence_words(unknown.law)}; {'fitted' if unknown.fitted else 'suggested'}:"
        found.append(
            _card("unknown", "unknown", [f"<p>{escape(said)}</p>", f"<p><code>{escape(unknown.expression)}</code></p>"])
        )
    return [f'<div class="cards">{"".join(found)}</div>'] if found else []


def _card(kind: str, title: str, lines: Sequence[str]) -> str:
    return f'<section class="card {kind}"><h3>{escape(title)}</h3>{"".join(lines).replace("+-", "±")}</section>'


def _effect(one: Found, sequence: Comparison) -> str:
    effect, noise = one.effect, "noise: " * (one.step is None)
    lines = [*_values(one.numbers), f"<p>{noise}{escape(effect.summary)}</p>"]
    if one.aliases:
        lines.append(f"<p>= {escape(', '.join(one.aliases))}: one error under two names</p>")
    if one.rivals:
        lines.append(f"<p>or {escape(', '.join(one.rivals))}: these data do not separate them</p>")
    percent = 100.0 * one.confidence
    lines.append(f'<span class="meter"><span style="width:{percent:.1f}%"></span></span>')
    lines.append(f"<p>{percent:.1f} % confidence, {one.nats:.0f} nats</p>")
    for model, extended in pairwise(sequence.evaluations):
        before, after = model.ten_second_error_m, extended.ten_second_error_m
        if extended.name == f"+ {effect.name}" and isfinite(before) and isfinite(after):
            change = f"{comparisons.size('along', before)} → <strong>{comparisons.size('along', after)}</strong>"
            lines.append(f"<p>10 s error {change}, held out</p>")
    return _card(effect.kind, one.names if noise else effect.name + texts.words_text(effect), lines)


def _values(numbers: Iterable[str]) -> list[str]:
    return [f'<p class="value">{escape(number)}</p>' for number in numbers]

"""Scores of a batch's estimates as text, Markdown, CSV, JUnit XML and JSON, with sentences of the page."""

from __future__ import annotations

import csv
import io
from collections import Counter
from dataclasses import asdict
from math import isfinite
from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import escape, quoteattr

from odomcorrupt.report.plain import picked
from odomcorrupt.scoring.errors import RPE_M, WINDOW_S
from odomcorrupt.scoring.gate import quantity
from odomcorrupt.scoring.run import METRICS, ODOMETRY, RunScore, ScoreReport
from odomcorrupt.summary import ALWAYS, MOST_LINES, Line, Summary, aligned

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from odomcorrupt.scoring.gate import Verdict
    from odomcorrupt.scoring.run import Status


METRIC_WORDS = {
    "ate_m": "ATE, position", "ate_rad": "ATE, heading", "max_m": "largest position error",
    "rpe_m": f"RPE over {RPE_M:g} m, position", "rpe_rad": f"RPE over {RPE_M:g} m, heading",
    "error_10s_m": f"error after {WINDOW_S:g} s", "end_m": "error at the end",
    "nees": "NEES per degree of freedom", "inside_95": "inside its own 95 % ellipsoid",
}  # fmt: skip
"""Rows of the table over runs."""

_STATUSES: tuple[Status, ...] = ("lost", "diverged", "partial", "missing", "unreadable")
_NAMED = 5
"""Runs that a failed rule names on the screen; -v, Markdown and JUnit name all."""
METRIC_HEADS = ("over runs", "n", "median", "95 % interval", "p90", "95 % interval", "max")
POINT_HEADS = ("drift", "runs", "lost", "median ATE", "p90", "point")
RUN_HEADS = ("run", "drift, %", "ATE, m", "RPE, m", "10 s, m", "end, m", "jumps", "status")


def point_rows(report: ScoreReport) -> list[list[str]]:
    """Return the rows of the table of points: drift, runs, lost, median and p90 of the ATE, name."""
    return [
        [_percent(p.drift), str(len(p.runs)), str(p.failed), *(quantity("ate_m", q.value) for q in (s.median, s.p90)),
         p.runs[0].point or "all runs"]
        for p in report.points for s in [p.summary("ate_m")]
    ]  # fmt: skip


def metric_rows(report: ScoreReport) -> list[list[str]]:
    """Return the rows of the table over runs: metric, number of runs, median and p90 with intervals, largest value."""
    rows = []
    for name, words in METRIC_WORDS.items():
        if (s := report.summary(name)).n:
            cells = [words, str(s.n)]
            for q in (s.median, s.p90):
                cells += [quantity(name, q.value), f"{quantity(name, q.low)} to {quantity(name, q.high)}"]
            rows.append([*cells, quantity(name, s.max)])
    return rows


def score_text(report: ScoreReport) -> str:
    """Return sentences, the tables of points and over runs, and a line for each run."""
    lines = [*sentences(report), ""]
    if len(report.points) > 1:
        lines += [*_aligned([POINT_HEADS, *point_rows(report)]), ""]
    lines += [*_aligned([METRIC_HEADS, *metric_rows(report)]), ""]
    lines += [*_aligned([RUN_HEADS, *map(run_cells, report.runs)])]
    lines += [f"Note: {note}." for note in report.notes]
    return "\n".join(lines)


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Return rows with their columns aligned: names to the left, which have no number in them, others to the right."""
    last = len(rows[-1]) - 1
    return aligned(rows, [i for i, cell in enumerate(rows[-1]) if i not in (0, last) or cell[:1].isdigit()])


def score_brief(report: ScoreReport, verdicts: Sequence[Verdict]) -> Summary:
    """Return the gate's result, the number of failed runs, the errors, the break-down point and the covariances."""
    said = _failed(report) + (f"; estimate: {ODOMETRY}" if report.estimate == ODOMETRY else "")
    bad = sum(one.failed for one in verdicts)
    if verdicts:
        broken = f"{bad} of {len(verdicts)} rules broken; {said}"
        lines = [Line("FAILED", broken, "bad") if bad else Line("PASSED", broken, "good")]
    elif report.identical:
        lines = [Line("IDENTICAL", f"in all runs: your localisation was not run again; {said}", "bad")]
    else:
        lines = [Line("SCORED", said, "warning" if report.failed else "good")]
    most = MOST_LINES + 2 * len(verdicts)
    for one in sorted(verdicts, key=lambda verdict: not verdict.failed):
        names = [*one.runs[:_NAMED], *([f"{len(one.runs) - _NAMED} more: -v names all"] * (len(one.runs) > _NAMED))]
        lines.append(Line("gate", one.sentence, "bad" if one.failed else "good", ALWAYS))
        lines += [Line("", name, "bad", ALWAYS) for name in names]
        most += 2 * len(names)
    if len(report.points) > 1:
        first, *rest = _aligned([POINT_HEADS, *point_rows(report)])
        lines += [Line("points", first, weight=ALWAYS), *(Line("", row, weight=ALWAYS) for row in rest)]
        most += len(rest) + 1
    for name, label in (("ate_m", "ATE"), ("rpe_m", "RPE")) if len(report.points) < 2 else ():
        s = report.summary(name)
        if s.n:
            values = (quantity(name, value) for value in (s.median.value, s.p90.value, s.max))
            lines.append(Line(label, "median {}, p90 {}, max {}".format(*values)))
    lines.append(Line("breaks", _breaks(report)))
    nees = report.summary("nees")
    if nees.n:
        lines.append(Line("NEES", f"{nees.median.value:.3g} per degree of freedom (1 is calibrated)"))
    lines += [Line("note", note, "warning") for note in report.notes]
    return Summary(tuple(lines), most)


def gate_lines(verdicts: Iterable[Verdict]) -> list[str]:
    """Return the sentence of each verdict, and the runs that made it fail."""
    return [line for one in verdicts for line in (f"{one.sentence}.", *(f"  {name}" for name in one.runs))]


def score_markdown(report: ScoreReport, verdicts: Sequence[Verdict]) -> str:
    """Return the gate's result, what failed, and the tables of points and over runs, for a summary page of CI."""
    failed = any(one.failed for one in verdicts)
    lines = [f"## {'FAILED: ' if failed else 'PASSED: ' if verdicts else ''}{report.estimate}, {_failed(report)}", ""]
    for one in verdicts:
        lines += [f"* {'**' * one.failed}{_cell(one.sentence)}{'**' * one.failed}"]
        lines += [f"    * {_cell(name)}" for name in one.runs]
    lines += ["", *_table(POINT_HEADS, point_rows(report)), ""]
    lines += [*_table(METRIC_HEADS, metric_rows(report)), ""]
    lines += [f"* {_cell(sentence)}" for sentence in (*sentences(report)[1:], *report.notes)]
    return "\n".join(lines) + "\n"


def _table(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> list[str]:
    return [f"| {' | '.join(map(_cell, row))} |" for row in (heads, ["---"] * len(heads), *rows)]


def _cell(text: str) -> str:
    """Return a text in which names of files and topics have no meaning for Markdown or HTML."""
    return escape(text).replace("|", "\\|").replace("_", "\\_").replace("*", "\\*")


def score_csv(report: ScoreReport) -> str:
    """Return the table of points as CSV: fractions and metres, "inf" for a statistic over runs without an output."""
    stream = io.StringIO()
    table = csv.writer(stream, lineterminator="\n")
    table.writerow(("point", "drift", "runs", "lost", "median_ate_m", "p90_ate_m"))
    for p in report.points:
        ate = p.summary("ate_m")
        table.writerow((p.runs[0].point, p.drift, len(p.runs), p.failed, ate.median.value, ate.p90.value))
    return stream.getvalue()


def score_junit(report: ScoreReport, verdicts: Sequence[Verdict]) -> str:
    """Return the gate as JUnit XML: a test case for each rule, and one for the reading of the runs."""
    failed = sum(one.failed for one in verdicts)
    cases = [f'  <testcase classname="odomcorrupt.score" name="{len(report.runs)} runs scored"/>']
    for one in verdicts:
        case = f'  <testcase classname="odomcorrupt.score" name={quoteattr(one.rule)}'
        text = escape("\n".join(gate_lines([one])))
        body = f"\n    <failure message={quoteattr(one.sentence)}>{text}</failure>\n  " if one.failed else ""
        cases.append(f"{case}>{body}</testcase>")
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n'
        f'<testsuite name="odomcorrupt score" tests="{len(cases)}" failures="{failed}" errors="0" skipped="0">\n'
        + "\n".join(cases)
        + f"\n  <system-out>{escape(score_text(report))}</system-out>\n</testsuite>\n"
    )


def _failed(report: ScoreReport) -> str:
    """Return the number of failed runs and their kinds, as "3 of 9 runs failed (2 lost, 1 missing)"."""
    counts = Counter(run.status for run in report.runs)
    parts = ", ".join(f"{counts[status]} {status}" for status in _STATUSES if counts[status])
    return f"{report.failed} of {len(report.runs)} runs failed" + (f" ({parts})" if parts else "")


def sentences(report: ScoreReport) -> list[str]:
    """Return the results over all runs, a sentence each, the most important first."""
    lines = [f"{_failed(report)}."]
    if without := sum(not run.scored for run in report.runs):
        lines.append(f"Errors of runs without a complete output, {without}, count as infinite.")
    if report.identical:
        lines.append("The estimates are identical in all runs: your localisation was not run again.")
    low, high = report.breakdown.low, report.breakdown.high
    bounds = " and ".join([f"above {_percent(low)}"] * (low > 0.0) + [f"below {_percent(high)}"] * isfinite(high))
    lines.append(f"Break-down point: {_breaks(report)}{f' (95 %: {bounds})' if bounds else ''}.")
    grown = report.growth
    if grown is not None:
        lines.append(
            f"The ATE of runs that were not lost grows with the drift to the power {grown.exponent:.2f} "
            f"(95 % interval {grown.low:.2f} to {grown.high:.2f})."
        )
    jumps = sum(len(run.jumps_s) for run in report.runs)
    if jumps:
        lines.append(
            f"Jumps of at least {report.limits.jump_m:g} m: {jumps}, in {sum(bool(r.jumps_s) for r in report.runs)} of "
            f"{len(report.runs)} runs."
        )
    lines += _place_sentences(report)
    nees = report.summary("nees")
    if nees.n:
        inside = report.summary("inside_95").median.value
        kind = "too small" if nees.median.value > 1.5 else "too large" if nees.median.value < 0.67 else "about right"
        lines.append(
            f"Its covariances are {kind}: NEES per degree of freedom {nees.median.value:.3g} (1 is calibrated), "
            f"{_percent(inside)} of the errors inside the 95 % ellipsoids."
        )
    return lines


def _percent(part: float) -> str:
    return f"{100.0 * part:.3g} %"


def _breaks(report: ScoreReport) -> str:
    """Return the drift at which 5 % of runs fail; beyond the drifts of the runs only that it is there."""
    found, drifts = report.breakdown, [run.drift for run in report.runs if isfinite(run.drift)]
    if not drifts:
        return "unknown: the drift of these runs is not known"
    least, most = _percent(min(drifts)), _percent(max(drifts))
    if found.drift is None:
        return f"unknown: too few runs, of drifts {least} to {most} per 10 m"
    if not found.drift:
        return f"5 % fail at less than {least} per 10 m, the smallest drift that was run"
    if not isfinite(found.drift):
        return f"5 % fail beyond {most} per 10 m, the largest drift that was run"
    return f"5 % fail at a drift of {_percent(found.drift)}; drifts {least} to {most} per 10 m"


def _place_sentences(report: ScoreReport) -> list[str]:
    parts = []
    known = [s for s in report.sections if s.runs]
    worst = max(known, key=lambda s: s.median_m, default=None)
    if worst is not None:
        parts.append(
            f"Errors are largest {worst.from_m:.1f} to {worst.to_m:.1f} m along the path, about ({worst.xy_m[0]:.1f}, "
            f"{worst.xy_m[1]:.1f}): median {quantity('_m', worst.median_m)}, p90 {quantity('_m', worst.p90_m)}."
        )
    most = max(known, key=lambda s: s.failures, default=None)
    if most is not None and most.failures > 1:
        parts.append(
            f"{most.failures} of {sum(s.failures for s in known)} losses begin {most.from_m:.1f} to {most.to_m:.1f} m "
            f"along the path, about ({most.xy_m[0]:.1f}, {most.xy_m[1]:.1f})."
        )
    return parts


def run_cells(run: RunScore) -> list[str]:
    """Return a row of the table of runs."""
    values = [100.0 * run.drift, *map(run.metrics.get, ("ate_m", "rpe_m", "error_10s_m", "end_m"))]
    numbers = ["-" if value is None or not isfinite(value) else f"{value:.3f}" for value in values]
    return [run.name, *numbers, str(len(run.jumps_s)), run.status + (f": {run.reason}" if run.reason else "")]


def score_json(report: ScoreReport, verdicts: Sequence[Verdict]) -> dict[str, Any]:
    """Return a report, and the verdicts of a gate, as values by name, without the schema: metres, radians, seconds."""
    return {
        **picked(report, "estimate", "truth", "align", "inputs", "failed", "identical", "notes"),
        **{name: asdict(getattr(report, name)) for name in ("limits", "breakdown")},
        "summary": {name: asdict(report.summary(name)) for name in METRICS},
        "points": [
            {**picked(p, "drift", lost="failed"), "name": p.runs[0].point, "runs": len(p.runs)}
            | {"ate": asdict(p.summary("ate_m"))}
            for p in report.points
        ],
        "growth": report.growth and asdict(report.growth),
        "sections": [asdict(section) for section in report.sections],
        "runs": [_run(run) for run in report.runs],
        "verdicts": [asdict(verdict) for verdict in verdicts],
    }


def _run(run: RunScore) -> dict[str, Any]:
    names = ("name", "seed", "run", "status", "reason", "scored", "failed", "drift", "drift_end_m", "jumps_s",
             "coverage", "frame", "source", "notes")  # fmt: skip
    return {
        **picked(run, *names),
        "metrics": {name: run.metrics.get(name) for name in METRICS},
        "failure": run.failure and asdict(run.failure),
        "events": [{"effect": name, "from_s": begin, "to_s": end} for name, begin, end in run.events],
    }

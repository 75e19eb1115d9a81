"""Scores of a batch's estimates as plain text, with the sentences that the HTML page shares."""

from __future__ import annotations

from collections import Counter
from math import degrees, isfinite
from typing import TYPE_CHECKING

from odomcorrupt.scoring.errors import RPE_M, WINDOW_S
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.scoring.gate import Verdict
    from odomcorrupt.scoring.run import RunScore, ScoreReport, Status
    from odomcorrupt.scoring.statistics import Quantile

METRIC_WORDS = {
    "ate_m": "ATE, position", "ate_rad": "ATE, heading", "max_m": "largest position error",
    "rpe_m": f"RPE over {RPE_M:g} m, position", "rpe_rad": f"RPE over {RPE_M:g} m, heading",
    "error_10s_m": f"error after {WINDOW_S:g} s", "end_m": "error at the end",
    "nees": "NEES per degree of freedom", "inside_95": "inside its own 95 % ellipsoid",
}  # fmt: skip
"""Rows of the table over runs."""

_STATUSES: tuple[Status, ...] = ("lost", "diverged", "partial", "missing", "unreadable")


def metric_text(metric: str, value: float) -> str:
    """Return a metric in a common unit; "-" if unknown."""
    if value != value:  # noqa: PLR0124 - NaN alone
        return "-"
    if not isfinite(value):
        return "unbounded"
    if metric.endswith("_rad"):
        return f"{degrees(value):.3g} deg"
    if metric.endswith("_m"):
        return f"{value * 1e3:.3g} mm" if value < 0.1 else f"{value:.3g} m"
    return _percent(value) if metric == "inside_95" else f"{value:.3g}"


def score_text(report: ScoreReport) -> str:
    """Return sentences, the table over runs, and a line for each run."""
    lines = [*sentences(report), ""]
    lines.append(
        f"{'over runs':<32}{'n':>5}{'median':>11}{'95 % interval':>22}{'p90':>11}{'95 % interval':>22}{'max':>11}"
    )
    for name, words in METRIC_WORDS.items():
        s = report.summary(name)
        if s.n:
            cells = (s.median.value, s.p90.value, s.max)
            median, p90, largest = (metric_text(name, value) for value in cells)
            lines.append(
                f"{words:<32}{s.n:>5}{median:>11}{_interval(name, s.median):>22}{p90:>11}"
                f"{_interval(name, s.p90):>22}{largest:>11}"
            )
    lines += ["", _row(run_heads()), *(_row(run_cells(run)) for run in report.runs)]
    lines += [f"Note: {note}." for note in report.notes]
    return "\n".join(lines)


def score_brief(report: ScoreReport, verdicts: Sequence[Verdict], *, following: Sequence[object]) -> Summary:
    """Return the number of failed runs, the gate's verdicts, the errors, the break-down point and the covariances.

    report : scores of the runs
    verdicts : verdicts of the gate's rules
    following : words of the suggested next command
    """
    failed, parts = _failed(report)
    said, gate = f"{failed} of {len(report.counted)} counted runs failed{parts}", any(one.failed for one in verdicts)
    lines = [Line("FAILED" if failed or gate else "HELD", said, "bad" if gate else "warning" if failed else "good")]
    # failed rules of the gate come first, because scripts depend on them
    ranked = sorted(verdicts, key=lambda verdict: not verdict.failed)
    lines += [Line("gate", one.sentence, "bad" if one.failed else "good") for one in ranked]
    for name, label in (("ate_m", "ATE"), ("rpe_m", "RPE")):
        s = report.summary(name)
        if s.n:
            values = (metric_text(name, value) for value in (s.median.value, s.p90.value, s.max))
            lines.append(Line(label, "median {}, p90 {}, max {}".format(*values)))
    drifts, point = _drifts(report), report.breakdown.drift
    span = f"drifts {drifts} per 10 m"
    breaks = f"5 % fail at a drift of {_percent(point)}; {span}" if point is not None else f"no point; {span}"
    lines.append(Line("breaks", breaks if drifts else "unknown: the drift of these runs is not known"))
    nees = report.summary("nees")
    if nees.n:
        lines.append(Line("NEES", f"{nees.median.value:.3g} per degree of freedom (1 is calibrated)"))
    lines += [Line("note", note, "warning") for note in report.notes]
    return Summary((*lines, command_line(following)))


def _failed(report: ScoreReport) -> tuple[int, str]:
    """Return the number of failed runs, and their kinds, as " (2 lost, 1 missing)"; "" if none failed."""
    counts = Counter(run.status for run in report.runs)
    parts = ", ".join(f"{counts[status]} {status}" for status in _STATUSES if counts[status])
    return sum(report.failed(run) for run in report.runs), f" ({parts})" if parts else ""


def _drifts(report: ScoreReport) -> str:
    """Return the smallest and the largest drift of the valid runs; "" if none is known."""
    drifts = [run.drift for run in report.counted if isfinite(run.drift)]
    return f"{_percent(min(drifts))} to {_percent(max(drifts))}" if drifts else ""


def sentences(report: ScoreReport) -> list[str]:
    """Return the results over all runs, a sentence each, the most important first."""
    failed, parts = _failed(report)
    lines = [f"{len(report.runs)} runs, {failed} of {len(report.counted)} counted ones failed{parts}."]
    left = len(report.runs) - len(report.counted)
    if left:
        lines.append(f"Not counted, without a complete output: {left}; --count-missing makes them failures.")
    lines.append(_breakdown_sentence(report))
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


def _breakdown_sentence(report: ScoreReport) -> str:
    found, drifts = report.breakdown, _drifts(report)
    if not drifts:
        return "The drift of these runs is not known, and so no break-down point."
    span = f"runs drift by {drifts} of the way, rms over 10 m"
    failed = sum(report.failed(run) for run in report.counted)
    if found.drift is None and not failed:
        low = f"; it lies above {_percent(found.low)} (95 %)" if found.low > 0.0 else ""
        return f"No break-down point: no run failed ({span}){low}."
    if found.drift is None and failed < len(report.counted):
        return f"Too few runs for a break-down point ({span})."
    if found.drift is None:
        high = f"; it lies below {_percent(found.high)} (95 %)" if isfinite(found.high) else ""
        return f"No break-down point: all runs failed ({span}){high}."
    high = _percent(found.high) if isfinite(found.high) else "more than was tried"
    return (
        f"Break-down point: at a drift of {_percent(found.drift)} of the way 5 % of runs fail (95 % interval "
        f"{_percent(found.low)} to {high}; {span})."
    )


def _place_sentences(report: ScoreReport) -> list[str]:
    parts = []
    known = [s for s in report.sections if s.runs]
    worst = max(known, key=lambda s: s.median_m, default=None)
    if worst is not None:
        parts.append(
            f"Errors are largest {worst.from_m:.1f} to {worst.to_m:.1f} m along the path, about ({worst.xy_m[0]:.1f}, "
            f"{worst.xy_m[1]:.1f}): median {metric_text('_m', worst.median_m)}, p90 {metric_text('_m', worst.p90_m)}."
        )
    most = max(known, key=lambda s: s.failures, default=None)
    if most is not None and most.failures > 1:
        parts.append(
            f"{most.failures} of {sum(s.failures for s in known)} losses begin {most.from_m:.1f} to {most.to_m:.1f} m "
            f"along the path, about ({most.xy_m[0]:.1f}, {most.xy_m[1]:.1f})."
        )
    return parts


def run_heads() -> list[str]:
    """Return the heads of the table of runs."""
    return ["run", "drift", "ATE", "RPE", "10 s", "end", "jumps", "status"]


def run_cells(run: RunScore) -> list[str]:
    """Return a row of the table of runs."""
    get = run.metrics.get
    numbers = [metric_text("_m", get(name, float("nan"))) for name in ("ate_m", "rpe_m", "error_10s_m", "end_m")]
    drift = _percent(run.drift) if isfinite(run.drift) else "-"
    return [run.name, drift, *numbers, str(len(run.jumps_s)), run.status + (f": {run.reason}" if run.reason else "")]


def _row(cells: list[str]) -> str:
    return f"{cells[0]:<20}" + "".join(f"{cell:>10}" for cell in cells[1:-1]) + f"  {cells[-1]}"


def _interval(metric: str, q: Quantile) -> str:
    return f"{metric_text(metric, q.low)} to {metric_text(metric, q.high)}"

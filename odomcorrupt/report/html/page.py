"""Framework of the self-contained HTML pages: head, style, script and common elements."""

from __future__ import annotations

import base64
from hashlib import sha256
from html import escape
from importlib.resources import files
from typing import TYPE_CHECKING

from odomcorrupt import __version__
from odomcorrupt.report.plots.figure import rendered
from odomcorrupt.report.plots.score import along, draw_alone, drift, places
from odomcorrupt.report.score import (
    METRIC_HEADS,
    POINT_HEADS,
    gate_lines,
    metric_rows,
    point_rows,
    run_cells,
    run_heads,
    sentences,
)
from odomcorrupt.scoring.gate import quantity

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from odomcorrupt.scoring.gate import Verdict
    from odomcorrupt.scoring.run import ScoreReport


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
    """Return a heading and a figure, with a name for links."""
    return (
        f'<h2>{escape(title)}</h2><figure id="{name}"><figcaption>{prose(caption)}</figcaption>'
        f'<img src="{_embedded(figure)}" alt="{escape(title)}: {escape(caption)}"></figure>'
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


def _embedded(figure: Figure) -> str:
    """Return a figure as a data URL: vectors, or pixels if the vectors are too large."""
    kind, data = "svg+xml", rendered(figure, "svg")
    # a figure with embedded pixels would not become smaller
    # size of a vector figure, bytes, above which it is rasterised if that is smaller; keeps the page below 3 MB
    if len(data) > 600_000 and b"data:image/png" not in data:
        pixels = rendered(figure, "png")
        kind, data = ("png", pixels) if len(pixels) < len(data) else (kind, data)
    return f"data:image/{kind};base64,{base64.b64encode(data).decode()}"


def score_html(report: ScoreReport, verdicts: Sequence[Verdict]) -> str:
    """Return the HTML page."""
    title = f"Localisation under drift: {report.estimate}, {len(report.runs)} runs"
    first, *rest = sentences(report)
    body = [
        f"<h1>{escape(title)}</h1>",
        f'<p class="quiet">Truth: {escape(report.truth)}. Alignment: {escape(report.align)}.</p>',
        *(f'<p class="verdict{" rejected" if v.failed else ""}">{"<br>".join(map(escape, gate_lines([v])))}</p>'
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
        table(POINT_HEADS, [list(map(escape, row)) for row in point_rows(report)]) if len(report.points) > 1 else "",
        "<h2>Over runs</h2>",
        table(METRIC_HEADS, [list(map(escape, row)) for row in metric_rows(report)]),
        _sections(report),
        "<h2>Runs</h2>",
        _runs(report),
        *(f'<p class="quiet">Note: {escape(note)}.</p>' for note in report.notes),
    ]  # fmt: skip
    return page(title, body, _legend(report))


def _sections(report: ScoreReport) -> str:
    rows = [
        [f"{s.from_m:.1f} to {s.to_m:.1f} m", f"{s.xy_m[0]:.2f}, {s.xy_m[1]:.2f}", str(s.runs),
         quantity("_m", s.median_m), quantity("_m", s.p90_m), f"!{s.failures}" if s.failures else "0"]
        for s in report.sections
    ]  # fmt: skip
    return table(("along the path", "x, y (m)", "runs", "median error", "p90", "losses begin"), rows, "Along the path")


def _runs(report: ScoreReport) -> str:
    # largest number of runs in the table; the worst ones are listed
    worst = sorted(report.runs, key=lambda run: -run.metrics.get("ate_m", float("inf")))[:1000]
    rows = []
    for run in worst:
        cells = [escape(cell) for cell in run_cells(run)]
        rows.append([*cells[:-1], cells[-1] if run.status == "ok" else f"!{cells[-1]}"])
    return table(run_heads(), rows, "The worst first")


def _legend(report: ScoreReport) -> str:
    limits = report.limits
    return (
        "ATE and RPE as evo defines them (root mean squares, the truth interpolated at the stamps of the estimate). "
        f"Lost: more than {limits.lost_m:g} m off for {limits.lost_s:g} s or until the end; diverged: ten times that "
        f"far. Jump: the error changes by {limits.jump_m:g} m within a second. Intervals of quantiles by order "
        "statistics, of the break-down point by profile likelihood of a logistic regression on the logarithm of the "
        "drift."
    )

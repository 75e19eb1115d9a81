"""odomcorrupt spread: dispersion of the runs of a batch."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from odomcorrupt.commands._options import PICTURE, save_picture
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, written
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.batching.dispersion import SpreadReport

_ERRORS = 2.0
"""Standard errors beyond which a dispersion differs from the prediction."""


@click.command("spread", short_help="Compare the spread of a batch's runs with the prediction.")
@click.argument("directory", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("-o", "--output", type=PICTURE, help="Picture to write: png, svg or pdf.")
@overwrite_option("an existing picture")
@standard_options
def command(directory: Path, output: Path | None, *, console: Console) -> None:
    """Show how position and heading of a batch's runs spread with the distance, and what the linear model predicts."""
    from odomcorrupt.batching.dispersion import measure

    report = measure(directory)
    rows = [asdict(row) for row in report.rows]
    words = {"schema": 2, "directory": report.directory, "runs": report.runs, "random_effects": report.random_effects}

    def draw(path: Path) -> None:
        from odomcorrupt.report.plots.samples import draw_spread

        save_picture(path, draw_spread(report))

    following = ["spread", directory, "-o", "spread.png"] if output is None else ["score", "-h"]
    console.print(_brief(report, following), _text(report), {**words, "rows": rows}, files=written(output, draw))


def _brief(report: SpreadReport, following: Sequence[object]) -> Summary:
    """Return whether the dispersion at the end is as predicted, and its values along the drive."""
    last = report.rows[-1]
    ratio = last.position_m / last.position_predicted_m if last.position_predicted_m else math.inf
    # standard error of the logarithm of a standard deviation from this many runs in two directions
    chance = _ERRORS / math.sqrt(4.0 * max(report.runs - 1, 1))
    off = math.inf if not ratio else math.log(ratio)
    verdict = "AS PREDICTED" if abs(off) <= chance else "WIDER" if off > 0.0 else "NARROWER"
    said = f"{ratio:.3g} times the predicted spread after {last.after_m:.4g} m, {report.runs} runs"
    lines = [Line(verdict, said, "good" if abs(off) <= chance else "warning")]
    for row in (report.rows[i] for i in sorted({0, len(report.rows) // 2, len(report.rows) - 1})):
        measured = f"{row.position_m:.3g} m, {math.degrees(row.heading_rad):.3g} deg"
        predicted = f"{row.position_predicted_m:.3g} m, {math.degrees(row.heading_predicted_rad):.3g} deg"
        lines.append(Line(f"{row.after_m:.4g} m", f"{measured} (predicted {predicted})"))
    mean = f"{last.mean_m:.3g} m, {math.degrees(last.mean_rad):.3g} deg off on average at the end"
    lines.append(Line("mean", mean))
    if report.random_effects:
        lines.append(Line("odd", f"not predicted: the draws of {', '.join(report.random_effects)}", "warning"))
    return Summary((*lines, command_line(["odomcorrupt", *following])))


def _text(report: SpreadReport) -> str:
    lines = [
        f"{report.directory}: {report.runs} runs; standard deviations about their mean, and as linearised (predicted)",
        "   after m   position m   predicted   heading deg   predicted    mean m   mean deg",
    ]
    lines += [
        f"{row.after_m:10.4g} {row.position_m:12.4g} {row.position_predicted_m:11.4g} "
        f"{math.degrees(row.heading_rad):13.4g} {math.degrees(row.heading_predicted_rad):11.4g} "
        f"{row.mean_m:9.3g} {math.degrees(row.mean_rad):10.3g}"
        for row in report.rows
    ]
    if report.random_effects:
        lines.append(f"The prediction does not include the draws of {', '.join(report.random_effects)}.")
    return "\n".join(lines)

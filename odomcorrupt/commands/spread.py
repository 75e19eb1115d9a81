"""odomcorrupt spread: dispersion of the runs of a batch."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from odomcorrupt.commands._options import PICTURE, save_picture
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, written


@click.command("spread", short_help="Compare the spread of a batch's runs with the prediction.")
@click.argument("directory", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("-o", "--output", type=PICTURE, help="Picture to write: png, svg or pdf.")
@overwrite_option("an existing picture")
@standard_options
def command(directory: Path, output: Path | None, *, console: Console) -> None:
    """Show how position and heading of a batch's runs spread with the distance, and what the linear model predicts."""
    from odomcorrupt.batching.dispersion import measure, spread_brief, spread_text

    report = measure(directory)
    values = {
        "schema": 2, "directory": report.directory, "runs": report.runs, "random_effects": report.random_effects,
        "rows": [asdict(row) for row in report.rows],
    }  # fmt: skip

    def draw(path: Path) -> None:
        from odomcorrupt.report.plots.samples import draw_spread

        save_picture(path, draw_spread(report))

    following = ["spread", directory, "-o", "spread.png"] if output is None else ["score", "-h"]
    console.print(spread_brief(report, following), spread_text(report), values, files=written(output, draw))

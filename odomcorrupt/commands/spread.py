"""odomcorrupt spread: dispersion of the runs of a batch."""

from __future__ import annotations

from pathlib import Path

import click

from odomcorrupt.commands._options import PICTURE
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, written


@click.command("spread", short_help="Compare the spread of a batch's runs with the prediction.")
@click.argument("directory", type=click.Path(exists=True, file_okay=False, path_type=Path))
@click.option("--plot", "-o", "--output", type=PICTURE, help="Picture: .png, .svg or .pdf.")
@overwrite_option("an existing picture")
@standard_options
def command(directory: Path, plot: Path | None, *, console: Console) -> None:
    """Show how position and heading of a batch's runs spread with the distance, and what the linear model predicts."""
    from odomcorrupt.api.batch import spread

    result = spread(directory)
    following = ("spread", directory, "--plot", "spread.png") if plot is None else ("score", "-h")
    console.show(result.then("odomcorrupt", *following), files=written(plot, result.plot))

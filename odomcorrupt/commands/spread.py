"""odomcorrupt spread: dispersion of the runs of a batch."""

from __future__ import annotations

import shlex
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
    from odomcorrupt.batching.manifest import read_records

    result, first = spread(directory), next(iter(read_records(directory).values()))
    # a trajectory is written as a bag; a bag's topics are looked up for `score`
    bag = directory / first["file"]
    made = shlex.split(first["command"]) if bag.suffix == ".tum" else ["odomcorrupt", "info", str(bag)]
    drawn = ["odomcorrupt", "spread", str(directory), "--plot", "spread.png"]
    console.show(result.then(*(drawn if plot is None else made)), files=written(plot, result.plot))

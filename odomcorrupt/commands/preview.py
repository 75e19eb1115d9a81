"""odomcorrupt preview: what these numbers will do to this bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from odomcorrupt.commands._model import MODEL_OPTIONS, AlphaCommand, choose_model, model_options
from odomcorrupt.commands._output import refuse_existing
from odomcorrupt.commands._poses import PICTURES, need_pictures, picture_kind, save_picture

__all__ = ["command"]


@click.command("preview", cls=AlphaCommand, short_help="Forecast what a motion model will do to a bag.")
@click.argument("input_", metavar="INPUT", type=click.Path(allow_dash=True))
@model_options
@click.option("--seed", type=click.IntRange(0), default=0, metavar="N", help="Of all draws. [default: 0]")
@click.option(
    "--runs", type=click.IntRange(2, 100_000), default=100, metavar="N", help="How many to draw. [default: 100]"
)
@click.option("--odom-topic", "--odom", "odom_topic", metavar="TOPIC", help="Odometry that drives the model.")
@click.option("--odom-frame", metavar="FRAME", help="Frame that drifts. [default: that of the odometry]")
@click.option("--base-frame", metavar="FRAME", help="The robot's frame. [default: the odometry's child frame]")
@click.option(
    "-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="Picture to write: png, svg or pdf."
)
@click.option("--overwrite", is_flag=True, help="Replace an existing picture.")
@click.option("--json", "as_json", is_flag=True, help="Print values for scripts: metres, radians, seconds.")
def command(input_: str, output: Path | None, **given: Any) -> None:
    """Draw many runs of a motion model over a bag's odometry and show how far they drift; no bag is written.

    Run k of a seed is the run that `odomcorrupt INPUT OUTPUT --seed N --run k` draws.
    """
    import json

    from odomcorrupt.bags.open import open_reader
    from odomcorrupt.corrupt.transform import Options
    from odomcorrupt.preview.forecast import forecast, read_clean_drive
    from odomcorrupt.preview.text import forecast_json, forecast_text

    chosen = choose_model(**{name: given[name] for name in MODEL_OPTIONS})
    if output is not None:
        if picture_kind(output) is None:
            raise click.UsageError(f"{output}: no kind of picture; name it .{', .'.join(PICTURES)}")
        need_pictures()
        refuse_existing(output, overwrite=given["overwrite"])
    options = Options(given["odom_topic"], given["odom_frame"], given["base_frame"])
    with open_reader(None if input_ == "-" else Path(input_)) as reader:
        drive = read_clean_drive(reader, chosen.model, options)
    outlook = forecast(drive, chosen.model, given["seed"], given["runs"])
    if given["as_json"]:
        click.echo(json.dumps(forecast_json(outlook, given["seed"]), indent=2))
    else:
        click.echo(forecast_text(outlook, chosen.model, chosen.origin, given["seed"]))
    if output is not None:
        from odomcorrupt.report.fan import draw_fan

        save_picture(output, draw_fan(outlook, f"{outlook.name}: what this model does to {outlook.distance_m:.3g} m"))

"""odomcorrupt preview: the drift that a model will cause in a bag."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands import corrupt
from odomcorrupt.commands._bag import bag_options, report_losses, source_of
from odomcorrupt.commands._map import choose_condition_of_run, map_options
from odomcorrupt.commands._model import AlphaCommand, choose_model, model_options
from odomcorrupt.commands._options import PICTURE, save_picture
from odomcorrupt.commands._progress import Progress
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, typed_words, written

if TYPE_CHECKING:
    from pathlib import Path


@click.command("preview", cls=AlphaCommand, short_help="Forecast what a motion model will do to a bag.")
@click.argument("input_", metavar="INPUT", type=click.Path(allow_dash=True))
@model_options
@click.option("--seed", type=click.IntRange(0), default=0, metavar="N", help="Seed of all draws. [default: 0]")
@click.option("--run", type=click.IntRange(0), default=0, metavar="N", help="The first of the runs. [default: 0]")
@click.option(
    "--runs", type=click.IntRange(2, 100_000), default=100, metavar="N", help="How many to draw. [default: 100]"
)
@bag_options
@map_options
@click.option("-o", "--output", type=PICTURE, help="Picture to write: png, svg or pdf.")
@overwrite_option("an existing picture")
@standard_options
def command(input_: str, output: Path | None, *, console: Console, **given: Any) -> int:
    """Draw many runs of a motion model over a bag's odometry and show how far they drift; no bag is written.

    Run k of a seed is the run that `odomcorrupt INPUT OUTPUT --seed N --run k` draws. Options of that command that
    concern only its output are accepted and ignored.
    """
    from odomcorrupt.bags.open import open_reader
    from odomcorrupt.corruption.inverse import SystematicEffects
    from odomcorrupt.corruption.path import NoisyPath
    from odomcorrupt.corruption.summary import per_message
    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.forecasting.forecast import brief, forecast, forecast_json, forecast_text, read_clean_drive

    chosen = choose_model(given)
    model = chosen.motion_model
    source, seed = source_of(input_), given["seed"]
    options = Options(given["odom_topic"], given["odom_frame"], given["base_frame"])
    condition = choose_condition_of_run(given, source, options, model)
    with open_reader(source, recover=given["recover"]) as reader, Progress(quiet=console.quiet) as progress:
        drive = read_clean_drive(reader, model, options, progress)
        losses = list(reader.losses)
    systematic = SystematicEffects(model)
    paths = (
        (None if condition is None else condition.path(model, seed, run, drive))
        or NoisyPath(model, seed, run, systematic=systematic)
        for run in range(given["run"], given["run"] + given["runs"])
    )
    outlook = forecast(drive, model, paths, first_run=given["run"])
    text = forecast_text(outlook, model, chosen.origin, seed)

    def draw(path: Path) -> None:
        from odomcorrupt.report.plots.paths import draw_fan

        title = f"{outlook.name}: what this model does to {outlook.distance_m:.3g} m"
        if per_message(model.noise) and outlook.rate_hz is not None:
            title += f" at {outlook.rate_hz:.3g} Hz; the noise depends on the message rate"
        save_picture(path, draw_fan(outlook, title))

    following = ["odomcorrupt", "preview", *typed_words("--output", "--overwrite"), "-o", "fan.png"]
    if output is not None:
        following = ["odomcorrupt", *typed_words("--output", "--overwrite", "--runs"), "noisy.mcap"]
    said = brief(outlook, model, chosen.origin, seed, following)
    console.print(said, text, forecast_json(outlook, model, seed), files=written(output, draw))
    return report_losses(losses)


def _options_of_the_output() -> list[click.Parameter]:
    """Return the options of corruption that are accepted but not used, so that one command line serves both."""
    own = {word for option in command.params for word in option.opts}
    found = [copy.copy(o) for o in corrupt.command.params if isinstance(o, click.Option) and own.isdisjoint(o.opts)]
    for option in found:
        option.hidden, option.expose_value = True, False
    return list(found)


command.params += _options_of_the_output()

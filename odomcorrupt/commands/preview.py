"""odomcorrupt preview: the drift that a model will cause in a bag."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands import corrupt
from odomcorrupt.commands._bag import bag_options, bag_words, report_losses, source_of
from odomcorrupt.commands._model import AlphaCommand, choose_condition_of_run, choose_model, map_options, model_options
from odomcorrupt.commands._options import PICTURE, seed_option, valued
from odomcorrupt.commands._progress import Progress
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, typed_words, written

if TYPE_CHECKING:
    from pathlib import Path


@click.command("preview", cls=AlphaCommand, short_help="Forecast what a motion model will do to a bag.")
@click.argument("input_", metavar="INPUT", type=click.Path(allow_dash=True))
@model_options
@seed_option
@valued("--run", kind=click.IntRange(0), default=0, metavar="N", text="The first of the runs.")
@valued("--runs", kind=click.IntRange(2, 100_000), default=100, metavar="N", text="How many to draw.")
@bag_options
@map_options
@click.option("--plot", "-o", "--output", type=PICTURE, help="Picture: .png, .svg or .pdf.")
@overwrite_option("an existing picture")
@standard_options
def command(input_: str, plot: Path | None, *, console: Console, **given: Any) -> int:
    """Draw many runs of a motion model over a bag's odometry and show how far they drift; no bag is written.

    Run k of a seed is the run that `odomcorrupt INPUT OUTPUT --seed N --run k` draws. Options of that command that
    concern only its output are accepted and ignored.
    """
    from odomcorrupt.api.preview import preview

    model = choose_model(given)
    source = source_of(input_)
    options = bag_words(given)
    condition = choose_condition_of_run(given, source, options, model)
    with Progress(quiet=console.quiet) as progress:
        asked = {"seed": given["seed"], "run": given["run"], "runs": given["runs"], "within": condition}
        result = preview(input_, model, **asked, watch=progress, **options)
    seed = () if given["seed"] is not None else ("--seed", str(result.seed))
    following = ["odomcorrupt", "preview", *typed_words(), *seed, "--plot", "fan.png"]
    if plot is not None:
        following = ["odomcorrupt", *typed_words("--runs"), "noisy.mcap", *seed]
    console.show(result.then(*following), files=written(plot, result.plot))
    return report_losses(result.losses)


# options of corruption are accepted but not used, so that one command line serves both
_OWN = {word for option in command.params for word in option.opts}
for _option in corrupt.command.params:
    if isinstance(_option, click.Option) and _OWN.isdisjoint(_option.opts):
        command.params.append(unused := copy.copy(_option))
        unused.hidden, unused.expose_value = True, False

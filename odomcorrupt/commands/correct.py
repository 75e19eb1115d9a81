"""odomcorrupt correct: removal of the systematic part of measured odometry."""

from __future__ import annotations

import sys
from typing import Any

import click

from odomcorrupt.commands._bag import (
    bag_words,
    container_options,
    frame_options,
    keep_localisation_option,
    keeping_options,
)
from odomcorrupt.commands._model import choose_model, effect_option, track_option
from odomcorrupt.commands._options import FILE, start, usage_errors
from odomcorrupt.commands._progress import Progress
from odomcorrupt.commands._standard import Console, chosen_output, output_option, standard_options
from odomcorrupt.errors import EffectError


@click.command("correct", short_help="Remove the systematic error from measured odometry.")
@click.argument("input_", metavar="INPUT", type=click.Path(allow_dash=True))
@click.argument("output", metavar="OUTPUT", type=click.Path(allow_dash=True), required=False)
@output_option()
@click.option("--model", type=FILE, help="Motion model, as `fit` and `learn` write it.")
@effect_option
@track_option
@frame_options
@keeping_options
@click.option(
    "--start", type=start,
    help="Start pose of the odometry in the frame of position-dependent effects, metres and radians (or 90deg); odom: "
    "its own frame. [required if they were learned]",
)  # fmt: skip
@keep_localisation_option
@container_options
@standard_options
def command(input_: str, output: str | None, output_option: str | None, *, console: Console, **given: Any) -> int:
    """Remove the effects of a model from a bag's odometry: its poses, twists and covariances, and its TF edges.

    INPUT is read twice, because the correction at a time depends on the whole motion; it cannot be a pipe, OUTPUT can.
    Random effects cannot be undone, except lost increments and the bias of a gyro at rest; the summary names them.
    """
    from odomcorrupt.api.corruption import correct
    from odomcorrupt.correction.run import require_start

    target = chosen_output(output, output_option)
    if input_ == "-":
        raise click.UsageError(
            "INPUT is a pipe, and correction reads a bag twice: the whole motion first; save it to a file and name that"
        )
    if target == "-" and sys.stdout.isatty():
        raise click.UsageError("OUTPUT is - but stdout is a terminal; redirect it to a file or a pipe")
    chosen = choose_model(given) if given["effects"] or given["model"] else None
    if chosen is not None and given["start"] is None:
        with usage_errors(EffectError):
            require_start(chosen.motion_model)
    with Progress(quiet=console.quiet) as progress:
        done = correct(input_, target, model=chosen, start_xyt=given["start"], watch=progress, **bag_words(given))
    console.show(done, bag=target)
    return 3 if done.losses else 0

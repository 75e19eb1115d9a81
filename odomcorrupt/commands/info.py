"""odomcorrupt info: contents of a bag, and the messages that corruption would modify."""

from __future__ import annotations

from typing import Any

import click

from odomcorrupt.commands._bag import bag_options, further_inputs, one_input, report_losses, source_of
from odomcorrupt.commands._progress import Progress
from odomcorrupt.commands._standard import Console, standard_options


@click.command("info", short_help="Show a bag's odometry, and what corruption would change.")
@click.argument("input_", metavar="INPUT", type=click.Path(allow_dash=True))
@further_inputs
@bag_options
@standard_options
def command(input_: str, further: tuple[str, ...], *, console: Console, **given: Any) -> int:
    """Show a bag's topics, frames and edges, its motion, anomalies, and topics that still contain the true motion."""
    from odomcorrupt.api.preview import info

    input_ = one_input((input_, *further))
    source_of(input_)  # a terminal is refused
    with Progress(quiet=console.quiet) as progress:
        result = info(input_, watch=progress, **given)
    console.show(result)
    return report_losses(result.losses)

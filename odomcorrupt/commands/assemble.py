"""odomcorrupt assemble: an overlay and its original combined into one bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from odomcorrupt.commands._bag import bag_words, container_options
from odomcorrupt.commands._progress import Stages
from odomcorrupt.commands._standard import Console, chosen_output, output_option, standard_options


@click.command("assemble", short_help="Combine an overlay of a batch with its original bag.")
@click.argument("run", metavar="RUN", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("output", metavar="OUTPUT", type=click.Path(), required=False)
@output_option()
@click.option(
    "--input",
    "original",
    type=click.Path(exists=True, path_type=Path),
    help="Original bag. [default: the batch's input]",
)
@container_options
@standard_options
def command(
    run: Path, output: str | None, output_option: str | None, original: Path | None, *, console: Console, **given: Any
) -> None:
    """Write the whole bag of RUN, an overlay made by `batch --output overlay` that has only the changed topics."""
    from odomcorrupt.api.batch import assemble

    target = chosen_output(output, output_option)
    with Stages("assembling", quiet=console.quiet):
        result = assemble(run, target, original, **bag_words(given))
    console.show(result, bag=target)

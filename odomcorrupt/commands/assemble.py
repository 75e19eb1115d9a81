"""odomcorrupt assemble: an overlay and its original combined into one bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from odomcorrupt.commands._bag import bag_words, container_options
from odomcorrupt.commands._progress import Stages
from odomcorrupt.commands._standard import Console, chosen_output, output_option, standard_options
from odomcorrupt.summary import Line, Summary, command_line


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
    from odomcorrupt.api.bag_options import split_options
    from odomcorrupt.batching.manifest import fingerprint_of, read_beginning
    from odomcorrupt.batching.split_layout import assemble
    from odomcorrupt.errors import BatchError

    target = Path(chosen_output(output, output_option))
    if original is None:
        noted = read_beginning(run.parent)["input"]
        original = Path(noted["path"])
        if not original.exists():
            raise BatchError(f"{original}: the batch's input is not there; name it with --input")
        if fingerprint_of(original) != noted["hash"]:
            raise BatchError(
                f"{original}: has changed since the batch was made from it; name the original with --input"
            )
    container = split_options(bag_words(given))[1]
    with Stages("assembling", quiet=console.quiet):
        count = assemble(run, original, target, container)
    sentence = f"{target}: {count} messages of {run} in place of those of {original}."
    values = {"schema": 2, "output": str(target), "messages": count, "run": str(run), "input": str(original)}
    found = Line("ASSEMBLED", f"{count} messages of {run.name} in place of those of {original.name}", "good")
    brief = Summary((found, command_line(["odomcorrupt", "info", target])))
    console.print(brief, sentence, values, err=True)

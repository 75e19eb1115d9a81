"""odomcorrupt assemble: an overlay and its original as one bag."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from odomcorrupt.commands._progress import say

__all__ = ["command"]


@click.command("assemble", short_help="Join an overlay of a batch with its original.")
@click.argument("run", metavar="RUN", type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.argument("output", metavar="OUTPUT", type=click.Path(path_type=Path))
@click.option(
    "--input", "original", type=click.Path(exists=True, path_type=Path), help="The original. [default: the batch's]"
)
@click.option("--overwrite", is_flag=True, help="Replace an existing output.")
@click.option("--compression", metavar="NAME", help="none, lz4, zstd (MCAP), bz2 (ROS 1). [default: as it was]")
@click.option("--level", type=int, metavar="N", help="Of compression. [default: a fast one]")
@click.option("--recover", is_flag=True, help="Read what is whole of a damaged original, as the batch did.")
def command(run: Path, output: Path, original: Path | None, **given: Any) -> None:
    """Write the whole bag that RUN, made by `batch --output overlay`, is the changed part of."""
    from odomcorrupt.batching.assemble import assemble
    from odomcorrupt.batching.manifest import BatchError, fingerprint_of, read_beginning
    from odomcorrupt.corruption.run import Container

    if original is None:
        told = read_beginning(run.parent)["input"]
        original = Path(told["path"])
        if not original.exists():
            raise BatchError(f"{original}: the batch's input is not there; name it with --input")
        if fingerprint_of(original) != told["hash"]:
            raise BatchError(
                f"{original}: is not what the batch was made from any more; name the original with --input"
            )
    container = Container(given["overwrite"], given["compression"], given["level"], given["recover"])
    count = assemble(run, original, output, container)
    say(f"{output}: {count} messages of {run} in the place of those of {original}.")

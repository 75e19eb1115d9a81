"""odomcorrupt diagnose: the physical effect that a model lacks."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from odomcorrupt.commands._options import MODELS
from odomcorrupt.commands._recordings import advice_files, advice_options, recording_options, split_arguments
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options

if TYPE_CHECKING:
    from pathlib import Path

    from odomcorrupt.api.findings import Diagnosis
    from odomcorrupt.commands._recordings import Reading


@click.command("diagnose", short_help="Name the physical effect that a model misses.")
@click.argument("arguments", nargs=-1, required=True, metavar="RECORDING... [MODEL.toml]", shell_complete=MODELS)
@recording_options(advice_options)
@overwrite_option("existing outputs")
@standard_options
def command(
    arguments: tuple[str, ...], *, reading: Reading, drive: Path | None, report: Path | None, console: Console
) -> None:
    """Rank the effects by evidence, with what each would gain on held-out data, and suggest the next command."""
    from odomcorrupt.api.findings import diagnose
    from odomcorrupt.api.model import as_model

    paths, names = split_arguments(arguments)
    if len(names) > 1:
        raise click.UsageError(f"{len(names)} models given; diagnose one at a time")
    # an unreadable model is reported before minutes of work
    model = as_model(names[0]) if names else None
    with reading.stages(console) as stages:
        runs, _ = reading.read(paths, console, stages, track=model.motion_model.track_m if model else None)
        result = diagnose(runs, names[0] if names else None, watch=stages)
    result = result.then(*_following(result, [*map(str, paths), *reading.words], names))
    console.show(result, files=advice_files(result, drive, report))


def _following(result: Diagnosis, words: list[str], models: list[str]) -> list[str]:
    """Return the command that adds the missing effects, or evaluates a model that lacks none."""
    if not all(run.positioned for run in result.recordings):
        return []  # a model needs travel
    if result.result.search.laws or not (result.missing or models):
        # only `learn` writes a dependence, and the effects found hold only beside it
        return ["odomcorrupt", "learn", *words, "-o", "robot.toml"]
    if not result.missing:
        return ["odomcorrupt", "compare", *words, *models]
    start = ["--start", models[0]] if models else []
    added = [word for effect in result.missing for word in ("--add", effect)]
    return ["odomcorrupt", "fit", *words, *start, *added, "-o", "robot.toml"]

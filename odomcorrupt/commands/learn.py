"""odomcorrupt learn: the whole loop, from recordings to a robot's model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from odomcorrupt.commands._options import OUTPUT, PICTURE
from odomcorrupt.commands._recordings import advice_files, advice_options, recording_options, split_arguments
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, typed_words, written
from odomcorrupt.errors import FitError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.commands._recordings import Reading


@click.command("learn", short_help="Fit, diagnose and add effects until none is missing.")
@click.argument("recordings", nargs=-1, required=True)
@click.option("-o", "--output", type=OUTPUT, help="Model file to write.")
@recording_options(
    click.option(
        "--validate", "--judge", "validate", type=click.Path(path_type=Path), multiple=True,
        help="Recording to evaluate the result on (repeatable).",
    ),
    click.option("--plot", type=PICTURE, help="Picture of the errors, before and after."),
    advice_options,
)  # fmt: skip
@overwrite_option("existing outputs")
@standard_options
def command(
    recordings: tuple[str, ...],
    *,
    reading: Reading,
    output: Path | None,
    validate: tuple[Path, ...],
    plot: Path | None,
    report: Path | None,
    drive: Path | None,
    console: Console,
) -> None:
    """Learn which effects a robot has, write its model, and show how the error changes.

    A model that makes the error on held-out data larger is not written.

    RECORDINGS are bags, folders of them, or lists (*.list) with a path a line. Without --validate, models are
    cross-validated: refitted without each recording, or each half of the only one, and evaluated on it.
    """
    from odomcorrupt.api.findings import learn

    paths, models = split_arguments(recordings)
    if models:
        raise click.UsageError(f"{models[0]} is a model; `fit --start` and `diagnose` take models")
    with reading.stages(console) as stages:
        runs, held_out = reading.read(paths, console, stages, held_out=validate)
        result = learn(runs, validate=held_out or (), watch=stages)
    evaluated_on = [*map(str, validate or paths), *reading.words]
    usable = not result.comparison.fails and result.result.reproduction.holds
    worse = output is not None and result.comparison.worse
    following = _following(None if worse else output, typed_words(), evaluated_on, usable=usable)
    result = result.then(*following)
    saved = written(None if worse else output, lambda path: result.model.save(path, overwrite=True))
    console.show(result, files={**saved, **advice_files(result, drive, report), **written(plot, result.plot)})
    if worse:
        raise FitError(
            f"{output}: not written: held-out data are predicted worse with this model than without effects; the "
            "report says what was tried; add recordings, or name the effects (`fit --add`)"
        )


def _following(model: Path | None, words: Sequence[str], evaluated_on: Sequence[str], *, usable: bool) -> list[str]:
    """Return the next command: evaluate the model, corrupt with it, or write one first."""
    if model is None:
        return ["odomcorrupt", "learn", *words, "-o", "robot.toml"]
    if not usable:
        return ["odomcorrupt", "compare", *evaluated_on, str(model), "-v"]
    return ["odomcorrupt", "sim.bag", "noisy.bag", "--model", str(model)]

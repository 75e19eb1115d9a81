"""odomcorrupt learn: the whole loop, from recordings to a robot's model."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from odomcorrupt.commands._advice import advice_files, advice_options, check_advice
from odomcorrupt.commands._poses import need_pictures, picture_kind
from odomcorrupt.commands._recordings import recording_options, split_arguments
from odomcorrupt.commands._standard import overwrite_option, standard_options
from odomcorrupt.files import refuse_existing

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.commands._recordings import Reading
    from odomcorrupt.commands._standard import Voice

__all__ = ["command"]


@click.command("learn", short_help="Fit, diagnose and add, until nothing is missing.")
@click.argument("recordings", nargs=-1, required=True)
@recording_options
@click.option("-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="Model file to write.")
@click.option(
    "--validate",
    "--judge",
    "validate",
    type=click.Path(path_type=Path),
    multiple=True,
    help="Recording to judge the result on (repeatable).",
)
@click.option(
    "--plot", type=click.Path(dir_okay=False, path_type=Path), help="Picture of the errors, before and after."
)
@advice_options
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
    overwrite: bool,
    voice: Voice,
) -> None:
    """Learn which effects a robot has, write its model, and show how the error changes.

    Without --validate, the models are cross-validated on halves of the recordings themselves.
    """
    from odomcorrupt.api.learning import learn

    paths, models = split_arguments(recordings)
    if models:
        raise click.UsageError(f"{models[0]} is a model; `fit --start` and `diagnose` take models")
    for path in (output, plot):
        refuse_existing(path, overwrite=overwrite)
    check_advice(drive, report, overwrite=overwrite)
    if plot is not None:
        if picture_kind(plot) is None:
            raise click.UsageError(f"--plot {plot}: says no kind of picture; end it in .png, .svg or .pdf")
        need_pictures()
    with reading.stages(voice) as stages:
        runs, held_out = reading.read_with_held_out(paths, validate, voice)
        result = learn(runs, validate=held_out or (), watch=stages)
    judged_on = [*map(str, validate or paths), *reading.words()]
    usable = not result.comparison.rejected and result.result.reproduction.holds
    result = replace(
        result,
        following=_following(output, [*map(str, paths), *reading.words()])
        if output is None or usable
        else f"odomcorrupt compare {shlex.join([*judged_on, str(output)])} -v",
    )
    files = dict(advice_files(result, drive, report))
    if output is not None:
        files = {output: lambda: result.model.save(output, overwrite=True), **files}
    if plot is not None:
        files[plot] = lambda: result.plot(plot)
    voice.show(result, files=files)


def _following(model: Path | None, words: Sequence[str]) -> str:
    """Return what to type when all is learned: corrupt with the model, or write one first."""
    if model is None:
        return f"odomcorrupt learn {shlex.join(words)} -o robot.toml"
    return f"odomcorrupt sim.bag noisy.bag --model {shlex.quote(str(model))}"

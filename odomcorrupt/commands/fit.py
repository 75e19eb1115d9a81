"""odomcorrupt fit: a robot's motion model from recordings of odometry and truth."""

from __future__ import annotations

import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import click

from odomcorrupt.commands._recordings import recording_options, split_arguments
from odomcorrupt.commands._standard import overwrite_option, standard_options
from odomcorrupt.files import refuse_existing

if TYPE_CHECKING:
    from odomcorrupt.commands._recordings import Reading
    from odomcorrupt.commands._standard import Voice

__all__ = ["command"]


@click.command("fit", short_help="Fit a robot's motion model to odometry and truth.")
@click.argument("recordings", nargs=-1, required=True)
@recording_options
@click.option("-o", "--output", type=click.Path(dir_okay=False, path_type=Path), help="Model file to write.")
@click.option("--start", type=click.Path(dir_okay=False, path_type=Path), help="Model file whose effects to refit.")
@click.option("--add", multiple=True, metavar="EFFECT", help="Effect to add to the start model (repeatable).")
@click.option("--law", help="Noise law, or all: the likeliest. [default: that of the start model, or diffusion]")
@overwrite_option()
@standard_options
def command(
    recordings: tuple[str, ...],
    *,
    reading: Reading,
    output: Path | None,
    start: Path | None,
    add: tuple[str, ...],
    law: str | None,
    overwrite: bool,
    voice: Voice,
) -> None:
    """Fit the noise coefficients, the truth's own noise, clocks and set-up, and the effects asked for.

    Of the set-up, a lever arm and a mounting yaw of the truth are fitted where the data show them. Several recordings
    are runs of one robot, each with a clock of its own.
    """
    from odomcorrupt.api.fit import fit, require_effects
    from odomcorrupt.api.model import Model

    paths, models = split_arguments(recordings)
    if models:
        raise click.UsageError(f"{models[0]} is a model; pass it with --start")
    refuse_existing(output, overwrite=overwrite)
    begin = None if start is None else Model.load(start)
    require_effects(begin, add)
    with reading.stages(voice) as stages:
        runs = reading.read(paths, voice, track=begin.motion_model.track_m if begin else None)
        stages("fit", 0.0)
        result = fit(runs, add, start=begin, law=law)
    words = [*map(str, paths), *reading.words()]
    following = f"odomcorrupt compare {shlex.join([*words, str(output or 'base.toml')])}"
    voice.show(replace(result, following=following if output is not None else ""))
    if output is not None:
        result.model.save(output, overwrite=True)
        voice.note(f"wrote {output}")

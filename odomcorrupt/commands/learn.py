"""odomcorrupt learn: the whole loop, from recordings to a robot's model."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from odomcorrupt.commands._options import OUTPUT, PICTURE
from odomcorrupt.commands._recordings import WORSE, advice_files, advice_options, recording_options, split_arguments
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, typed_words, written
from odomcorrupt.errors import FitError

if TYPE_CHECKING:
    from odomcorrupt.commands._recordings import Reading
    from odomcorrupt.model.motion_model import MotionModel


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
    model = None if result.comparison.worse else output
    if model is None:
        following = ["learn", *typed_words(), "-o", "robot.toml"]
    elif result.comparison.fails or not result.result.reproduction.holds:
        following = ["compare", *map(str, validate or paths), *reading.words, str(model), "-v"]
    else:
        result = result.then(*_remedy(result.model.motion_model, model, paths[0]))
        following = ["sim.bag", "noisy.bag", "--model", str(model)]
    result = result.then("odomcorrupt", *following)
    saved = written(model, lambda path: result.model.save(path, overwrite=True))
    console.show(result, files={**saved, **advice_files(result, drive, report), **written(plot, result.plot)})
    if output is not None and model is None:
        raise FitError(WORSE.format(output, "add recordings, or name the effects (`fit --add`)"))


def _remedy(robot: MotionModel, model: Path, recording: Path) -> list[object]:
    """Return the command that takes what was found out of the robot's odometry: its wheels, or else of a recording."""
    from odomcorrupt.export import WHEEL_EFFECTS

    wheels = {effect.name for effect in robot.effects} & WHEEL_EFFECTS
    if wheels and (robot.track_m is not None or "unequal_wheels" not in wheels):
        return ["odomcorrupt", "export", model, "--to", "ros2_control"]
    if any(effect.kind != "noise" for effect in robot.effects) and not robot.placed:
        return ["odomcorrupt", "correct", recording, f"corrected{recording.suffix}", "--model", model]
    return []

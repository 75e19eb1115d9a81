"""odomcorrupt fit: a robot's motion model from recordings of odometry and truth."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import click

from odomcorrupt.commands._options import EFFECTS, FILE, MODELS, OUTPUT, number
from odomcorrupt.commands._recordings import WORSE, Reading, recording_options, split_arguments
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, typed_words, written
from odomcorrupt.errors import FitError

if TYPE_CHECKING:
    from pathlib import Path


@click.command("fit", short_help="Fit a robot's motion model to odometry and truth.")
@click.argument("recordings", nargs=-1, required=True, shell_complete=MODELS)
@click.option("-o", "--output", type=OUTPUT, help="Model file to write.")
@recording_options(
    click.option(
        "--add", "--effect", "add", multiple=True, metavar="EFFECT", shell_complete=EFFECTS,
        help="Effect to add to the start model (repeatable).",
    ),
    click.option("--start", type=FILE, help="Model file whose effects to refit."),
    click.option(
        "--law", help="Noise law, or all: select the most likely. [default: that of the start model, or diffusion]"
    ),
    click.option(
        "--returns", is_flag=True,
        help="Square test (UMBmark): the only truth is that the drives ended where they began, at --end, or where "
        "their last scans (--scan) match the first.",
    ),
    click.option(
        "--end", "ends", multiple=True, metavar="X,Y,YAW",
        help="Measured end pose relative to the start pose (m, m, deg): one for all drives, or one for each.",
    ),
)  # fmt: skip
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
    returns: bool,
    ends: tuple[str, ...],
    console: Console,
) -> None:
    """Fit the noise coefficients, the truth's own noise, clocks and set-up, and the requested effects.

    Of the set-up, a lever arm and a mounting yaw of the truth are fitted if the data show them. Several recordings
    are runs of one robot, each with its own clock. A model that makes the error on held-out data larger is not written.
    """
    from odomcorrupt.api.findings import compare, fit, fit_returns, require_effects
    from odomcorrupt.api.model import Model, as_model

    paths, models = split_arguments(recordings)
    if models:
        raise click.UsageError(f"{models[0]} is a model; pass it with --start")
    if returns or ends:
        if ends and reading.given["scan"]:
            raise click.UsageError("--end and --scan: scans measure where a drive ended; leave one of them out")
        given = reading.given
        for name in ("truth", "truth_bags", "imu", "relative"):
            if given[name]:
                flag = name.removesuffix("s").replace("_", "-")
                said = f"--returns and --{flag}: the ends are the only truth then; leave one of them out"
                raise click.UsageError(said)
        poses = [_end(text) for text in ends or ("0,0,0",)]
        if len(poses) not in (1, len(paths)):
            raise click.UsageError(f"{len(poses)} --end for {len(paths)} drives; give one for all, or one for each")
        asked = {"odom": given["odom"], "track_m": given["track"], "scan": given["scan"]}
        with reading.stages(console):
            found = fit_returns(paths, poses, effects=add, **asked)
        console.show(found, files=written(output, lambda path: found.model.save(path, overwrite=True)))
        return
    begin = None if start is None else as_model(str(start))
    require_effects(begin, add)
    with reading.stages(console) as stages:
        runs, _ = reading.read(paths, console, stages, track=begin.motion_model.track_m if begin else None)
        stages("fit" if output is None else "fit, cross-validation", 0.0)
        result = fit(runs, add, start=begin, law=law)
        without = Model.of(replace(result.model.motion_model, effects=()))
        worse = output is not None and result.model != without and compare(runs, [without, result.model]).worse
    model = None if worse else output
    again = ["fit", *typed_words(), "-o", "robot.toml"]
    following = ["compare", *map(str, paths), *reading.words, str(model)] if model else again
    files = written(model, lambda path: result.model.save(path, overwrite=True))
    console.show(result.then("odomcorrupt", *following), files=files)
    if model != output:
        raise FitError(WORSE.format(output, "leave effects out, or let `learn` select them"))


def _end(text: str) -> tuple[float, float, float]:
    """Return the pose given as x,y,yaw, the yaw in degrees."""
    try:
        x, y, yaw = map(number("x,y,yaw in metres and degrees"), text.split(","))
    except (ValueError, click.UsageError):
        raise click.UsageError(f"--end {text}: write x,y,yaw in metres and degrees, finite numbers") from None
    return x, y, math.radians(yaw)

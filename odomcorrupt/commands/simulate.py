"""odomcorrupt simulate: a recording of a robot with a fault, from wheels, ground and clocks."""

from __future__ import annotations

import sys
from math import isfinite, nan, radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._param_types import Number
from odomcorrupt.commands._progress import Stages
from odomcorrupt.commands._standard import chosen_output, output_option, overwrite_option, standard_options
from odomcorrupt.errors import EffectError
from odomcorrupt.files import refuse_existing, write_text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.commands._standard import Voice

__all__ = ["command", "faults_of", "size_of"]

HEADINGS = {"wheels": "encoders", "gyro": "gyro"}
"""Sources of heading, as users and as the simulator call them."""
_LARGEST = 100.0
"""Largest factor on the usual size of a fault with which a drive is possible."""


def faults_of(effects: Sequence[str], heading: str | None) -> tuple[list[str], dict[str, dict[str, float | str]]]:
    """Return the names of the faults asked for (none: they are drawn), and their parameters as far as given.

    Parameters
    ----------
    effects : as in "wheelbase:e=0.01", "hidden" or "none"
    heading : {"wheels", "gyro"} or None
        Source of heading asked for.
    """
    from odomcorrupt.simulation.fault_draws import EVERY, names_of, source_of_turns

    if "hidden" in effects and len(effects) > 1:
        raise click.UsageError("--effect hidden: stands alone, since what else there is would be known")
    if "none" in effects and len(effects) > 1:
        raise click.UsageError("--effect none: stands alone; leave it out or leave out the others")
    if not effects or "hidden" in effects:
        return [], {}
    if "none" in effects:
        return ["none"], {}
    given = dict(_parse(text) for text in effects)
    try:
        causes = names_of([text.partition(":")[0].strip() for text in effects])
        chosen = HEADINGS[heading] if heading else source_of_turns(causes)
    except EffectError as error:
        raise click.UsageError(f"--effect {error}") from error
    for name in causes:
        if chosen not in EVERY[name].shows_with:
            raise click.UsageError(f"--heading {heading}: {name} does not show with it; choose the other source")
    return list(causes), given


def _parse(text: str) -> tuple[str, dict[str, float | str]]:
    name, _, rest = text.partition(":")
    values: dict[str, float | str] = {}
    for part in rest.split(",") if rest else ():
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise click.UsageError(f"--effect {text}: {part!r} is not key=value; write as in wheel_scale:e=0.01")
        try:
            number = radians(float(value[:-3])) if value.endswith("deg") else float(value)
        except ValueError:
            values[key] = value
            continue
        if not isfinite(number):
            raise click.UsageError(f"--effect {text}: {key} is {value}; write a number, as in wheel_scale:e=0.01")
        values[key] = number
    return name.strip(), values


def size_of(text: str) -> float:
    """Return by how much a size in words or figures multiplies a drawn fault."""
    from odomcorrupt.simulation.fault_draws import SIZES

    try:
        size = SIZES[text] if text in SIZES else float(text)
    except ValueError:
        size = nan
    if not 0.0 < size <= _LARGEST:
        raise click.UsageError(
            f"--size {text}: give weak, medium, strong or a number of more than 0, up to {_LARGEST:g}"
        )
    return size


@click.command("simulate", short_help="Record a simulated robot with a hidden or a chosen fault.")
@click.argument("output", type=click.Path(dir_okay=False), required=False)
@output_option()
@click.option(
    "--effect",
    "effects",
    multiple=True,
    metavar="hidden|none|NAME[:KEY=VALUE,...]",
    help="What is wrong with the robot (repeatable; a wrong name lists all). [default: hidden]",
)
@click.option(
    "--size", default="medium", show_default=True, help="Size of a drawn fault: weak, medium, strong, number."
)
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the drive and its noise.")
@click.option("--robot", type=click.IntRange(0), help="Seed of the robot and its fault. [default: the drive's]")
@click.option(
    "--route",
    type=click.Choice(["office", "loops", "shuttle", "slalom", "yard", "umbmark"]),
    default="office",
    show_default=True,
    help="Where it drives; with --drive, where its fault has been met.",
)
@click.option(
    "--drive",
    type=click.Path(exists=True, path_type=Path),
    help="Bag whose /cmd_vel it follows instead, as `diagnose --drive` writes it.",
)
@click.option("--truth", type=click.Choice(["mocap", "rtk"]), default="mocap", show_default=True, help="Who watches.")
@click.option(
    "--heading", type=click.Choice(["wheels", "gyro"]), help="Source of its heading. [default: what the fault needs]"
)
@click.option("--drive-type", type=click.Choice(["differential", "skid"]), default="differential", show_default=True)
@click.option(
    "--duration", "duration_s", type=Number("seconds", 10.0, 1e6), help="Seconds. [default: 600, or as long as --drive]"
)
@click.option("--answer", type=click.Path(dir_okay=False, path_type=Path), help="Answer. [default: OUTPUT.answer.toml]")
@overwrite_option("existing files")
@standard_options
def command(
    output: str | None, output_option: str | None, *, effects: tuple[str, ...], size: str, voice: Voice, **given: Any
) -> None:
    """Drive a robot whose wheels, tyres, gear, sensors or clocks have a fault, and record odometry and truth.

    What is wrong is written to a file of its own, and only that file's SHA-256 into the bag.
    """
    from odomcorrupt.api.simulation import simulate

    target = chosen_output(output, output_option)
    piped = target == "-"
    if piped and given["answer"] is None:
        raise click.UsageError("a bag on a pipe needs a name for its answer; give --answer FILE")
    names, parameters = faults_of(effects, given["heading"])
    if piped:
        answer, overwrite = given.pop("answer"), given.pop("overwrite")
        refuse_existing(answer, overwrite=overwrite)
        done = simulate(None, effects=names, parameters=parameters, size=size_of(size), **given)
        write_text(answer, done.answer_text)
        sys.stdout.buffer.write(done.bag)
        voice.note(f"wrote stdout: {done.settings['duration_s']:g} s; what is wrong is in {answer}")
        return
    with Stages("simulation", quiet=voice.quiet):
        done = simulate(target, effects=names, parameters=parameters, size=size_of(size), **given)
    voice.show(done, err=True)

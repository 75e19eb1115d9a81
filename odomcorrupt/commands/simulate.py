"""odomcorrupt simulate: a recording of a robot with a fault, from wheels, ground and clocks."""

from __future__ import annotations

import sys
from math import isfinite, nan, radians
from pathlib import Path
from typing import Any

import click

from odomcorrupt.commands._options import EFFECTS, FILE, number, setting, usage_errors, valued
from odomcorrupt.commands._progress import Stages
from odomcorrupt.commands._standard import Console, chosen_output, output_option, overwrite_option, standard_options
from odomcorrupt.errors import EffectError

_ALONE = {
    "hidden": "cannot be combined with another fault, whose presence would then be known",
    "none": "cannot be combined with another fault; leave it out or leave out the others",
}
_LARGEST = 100.0
"""Largest factor on the usual size of a fault at which the robot can still be driven."""


def _parse(text: str) -> tuple[str, dict[str, float | str]]:
    """Return the name of a requested fault, and its parameters as far as given."""
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


def _size(text: str) -> float:
    """Return the factor on a drawn fault for a size in words or figures."""
    from odomcorrupt.simulation.faults import SIZES

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
    "--effect", "effects", multiple=True, metavar="hidden|none|NAME[:KEY=VALUE,...]", shell_complete=EFFECTS,
    help="Fault of the robot (repeatable; an unknown name lists all). [default: hidden]",
)  # fmt: skip
@valued("--size", kind=str, default="medium", text="Size of a drawn fault: weak, medium, strong, number.")
@setting("--seed", type=click.IntRange(0), help="Seed of the drive and its noise. [default: drawn, and printed]")
@click.option("--robot", type=click.IntRange(0), help="Seed of the robot and its fault. [default: the drive's]")
@valued(
    "--route", among=["office", "loops", "shuttle", "slalom", "yard", "umbmark"],
    text="Route; with --drive, the route from which the place of a fault is drawn.",
)  # fmt: skip
@click.option(
    "--drive", type=click.Path(exists=True, path_type=Path),
    help="Bag whose /cmd_vel the robot follows instead, as written by `diagnose --drive`.",
)  # fmt: skip
@valued("--truth", among=["mocap", "rtk"], text="Instrument that records the truth.")
@click.option(
    "--heading", type=click.Choice(["wheels", "gyro"]),
    help="Source of the odometry's heading. [default: as the fault requires]",
)  # fmt: skip
@valued("--drive-type", among=["differential", "skid"], text="Wheel layout.")
@click.option(
    "--duration", "duration_s", type=number("seconds", 10.0, 1e6),
    help="Duration of the drive, seconds. [default: 600, or that of --drive]",
)  # fmt: skip
@click.option("--answer", type=FILE, help="File for the true faults. [default: OUTPUT.answer.toml]")
@overwrite_option("existing files", passed=True)
@standard_options
def command(
    output: str | None,
    output_option: str | None,
    *,
    effects: tuple[str, ...],
    size: str,
    console: Console,
    **given: Any,
) -> None:
    """Drive a robot whose wheels, tyres, gear, sensors or clocks have a fault, and record odometry and truth.

    The faults are written to a separate file, of which the bag contains only the SHA-256.
    """
    from odomcorrupt.api.simulation import simulate

    target = chosen_output(output, output_option)
    piped = target == "-"
    if piped and given["answer"] is None:
        raise click.UsageError("a bag on a pipe needs a name for its answer; give --answer FILE")
    for word, why in _ALONE.items():
        if word in effects and len(effects) > 1:
            raise click.UsageError(f"--effect {word}: {why}")
    faults = [_parse(text) for text in effects if text != "hidden"]
    asked: dict[str, Any] = {"effects": [name for name, _ in faults], "size": _size(size)}
    asked["parameters"] = {name: values for name, values in faults if name != "none"}
    with usage_errors(EffectError, "--effect "), Stages("simulation", quiet=console.quiet):
        done = simulate(None if piped else target, **asked, **given)
    if piped:
        sys.stdout.buffer.write(done.bag)
        console.note(f"wrote stdout: {done.settings['duration_s']:g} s; its faults are listed in {done.answer_path}")
    else:
        console.show(done, bag=target)

"""odomcorrupt simulate: a recording of a robot that has a flaw, from wheels, ground and clocks."""

from __future__ import annotations

import io
import sys
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING

import click

from odomcorrupt.commands._output import refuse_existing, write_bytes, write_text
from odomcorrupt.commands._recordings import need_study
from odomcorrupt.errors import EffectError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.simulate.flaws import Hidden

__all__ = ["command"]

_HEADINGS = {"wheels": "encoders", "gyro": "gyro"}


@click.command("simulate", short_help="Record a simulated robot with a hidden or a chosen flaw.")
@click.argument("output", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--effect",
    "effects",
    multiple=True,
    metavar="hidden|none|NAME[:KEY=VALUE,...]",
    help="What is wrong with the robot (repeatable). [default: hidden]",
)
@click.option("--size", default="medium", show_default=True, help="Size of a drawn flaw: weak, medium, strong, number.")
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, help="Seed of the drive and its noise.")
@click.option("--robot", type=click.IntRange(0), help="Seed of the robot and its flaw. [default: the drive's]")
@click.option(
    "--route",
    type=click.Choice(["office", "loops", "shuttle", "slalom", "yard", "umbmark"]),
    default="office",
    show_default=True,
    help="Where it drives; with --drive, where its flaw has been met.",
)
@click.option(
    "--drive",
    type=click.Path(exists=True, path_type=Path),
    help="Bag whose /cmd_vel it follows instead, as `diagnose --drive` writes it.",
)
@click.option("--truth", type=click.Choice(["mocap", "rtk"]), default="mocap", show_default=True, help="Who watches.")
@click.option(
    "--heading", type=click.Choice(["wheels", "gyro"]), help="Source of its heading. [default: what the flaw needs]"
)
@click.option("--drive-type", type=click.Choice(["differential", "skid"]), default="differential", show_default=True)
@click.option("--duration", type=click.FloatRange(10.0), help="Seconds. [default: 600, or as long as --drive]")
@click.option("--answer", type=click.Path(dir_okay=False, path_type=Path), help="Answer. [default: OUTPUT.answer.toml]")
@click.option("--overwrite", is_flag=True, help="Replace existing files.")
def command(
    output: Path,
    effects: tuple[str, ...],
    size: str,
    seed: int,
    robot: int | None,
    route: str,
    drive: Path | None,
    truth: str,
    heading: str | None,
    drive_type: str,
    duration: float | None,
    answer: Path | None,
    overwrite: bool,  # noqa: FBT001 - click passes flags so
) -> None:
    """Drive a robot whose wheels, tyres, gear, sensors or clocks have a flaw, and record odometry and truth.

    What is wrong is written to a file of its own, and only that file's SHA-256 into the bag.
    """
    need_study()
    from odomcorrupt.simulate.answer import fingerprint, format_answer
    from odomcorrupt.simulate.bag import write_mcap
    from odomcorrupt.simulate.commands import read_commands
    from odomcorrupt.simulate.run import simulate

    piped = str(output) == "-"
    if piped and answer is None:
        raise click.UsageError("a bag on a pipe needs a name for its answer; give --answer FILE")
    secret = output.with_suffix(".answer.toml") if answer is None else answer
    for path in (secret,) if piped else (output, secret):
        refuse_existing(path, overwrite=overwrite)
    hidden, given = _what_is_wrong(effects, seed if robot is None else robot, heading)
    commands = None if drive is None else read_commands(drive)
    duration_s = duration or (600.0 if commands is None else commands.duration_s)
    run = simulate(
        seed,
        hidden.causes,
        duration_s=duration_s,
        size=_size(size),
        truth=truth,
        parameters=given,
        route=commands or route,
        yaw_from=hidden.yaw_from,
        robot_seed=robot,
        drive_type=drive_type,
        home=route,
    )
    made: dict[str, str | float] = {
        "robot": seed if robot is None else robot,
        "route": route if drive is None else drive.name,
        "duration_s": duration_s,
        "truth": truth,
        "heading": next(name for name, source in _HEADINGS.items() if source == hidden.yaw_from),
        "drive_type": drive_type,
        "size": _size(size),
    }
    text = format_answer(run, seed, made)
    bag = io.BytesIO()
    write_mcap(run, bag, metadata={"answer_sha256": fingerprint(text)})
    write_text(secret, text)
    if piped:
        sys.stdout.buffer.write(bag.getvalue())
    else:
        write_bytes(output, bag.getvalue())
    click.echo(
        f"wrote {'stdout' if piped else output}: {duration_s:g} s of /odom and /ground_truth, heading from "
        f"{made['heading']}, nominal track {run.track_m} m; what is wrong is in {secret}",
        err=True,
    )


def _what_is_wrong(
    effects: Sequence[str], robot: int, heading: str | None
) -> tuple[Hidden, dict[str, dict[str, float | str]]]:
    """Return the causes asked for, and their parameters as far as these are given."""
    from odomcorrupt.simulate.flaws import EVERY, Hidden, draw_causes, names_of, source_of_turns

    source = _HEADINGS[heading] if heading else None
    if not effects or "hidden" in effects:
        if len(effects) > 1:
            raise click.UsageError("--effect hidden: stands alone, since what else there is would be known")
        return draw_causes(robot, source), {}
    if "none" in effects:
        if len(effects) > 1:
            raise click.UsageError("--effect none: stands alone; leave it out or leave out the others")
        return Hidden((), source or "encoders"), {}
    given = dict(_parse(text) for text in effects)
    try:
        causes = names_of([text.partition(":")[0].strip() for text in effects])
        chosen = source or source_of_turns(causes)
    except EffectError as error:
        raise click.UsageError(f"--effect {error}") from error
    for name in causes:
        if chosen not in EVERY[name].shows_with:
            raise click.UsageError(f"--heading {heading}: {name} does not show with it; choose the other source")
    return Hidden(causes, chosen), given


def _parse(text: str) -> tuple[str, dict[str, float | str]]:
    name, _, rest = text.partition(":")
    values: dict[str, float | str] = {}
    for part in rest.split(",") if rest else ():
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise click.UsageError(f"--effect {text}: {part!r} is not key=value; write as in wheel_scale:e=0.01")
        try:
            values[key] = radians(float(value[:-3])) if value.endswith("deg") else float(value)
        except ValueError:
            values[key] = value
    return name.strip(), values


def _size(text: str) -> float:
    from odomcorrupt.simulate.flaws import SIZES

    try:
        return SIZES[text] if text in SIZES else float(text)
    except ValueError as error:
        raise click.UsageError(f"--size {text}: give weak, medium, strong or a number") from error

"""odomcorrupt simulate: a recording of a robot that has a flaw, from wheels, ground and clocks."""

from __future__ import annotations

import io
import sys
from pathlib import Path

import click

from odomcorrupt.commands._fault_options import HEADINGS, size_of, what_is_wrong
from odomcorrupt.commands._output import refuse_existing, write_bytes, write_text
from odomcorrupt.commands._param_types import Number
from odomcorrupt.extras import require

__all__ = ["command"]


@click.command("simulate", short_help="Record a simulated robot with a hidden or a chosen flaw.")
@click.argument("output", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--effect",
    "effects",
    multiple=True,
    metavar="hidden|none|NAME[:KEY=VALUE,...]",
    help="What is wrong with the robot (repeatable; a wrong name lists all). [default: hidden]",
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
@click.option("--duration", type=Number("seconds", 10.0, 1e6), help="Seconds. [default: 600, or as long as --drive]")
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
    require("scipy", "the study needs it", "study")
    from odomcorrupt.simulation.bag import write_mcap
    from odomcorrupt.simulation.commands import read_commands
    from odomcorrupt.simulation.record import fingerprint, format_answer
    from odomcorrupt.simulation.run import simulate

    piped = str(output) == "-"
    if piped and answer is None:
        raise click.UsageError("a bag on a pipe needs a name for its answer; give --answer FILE")
    secret = output.with_suffix(".answer.toml") if answer is None else answer
    for path in (secret,) if piped else (output, secret):
        refuse_existing(path, overwrite=overwrite)
    hidden, given = what_is_wrong(effects, seed if robot is None else robot, heading)
    commands = None if drive is None else read_commands(drive)
    duration_s = duration or (600.0 if commands is None else commands.duration_s)
    run = simulate(
        seed,
        hidden.causes,
        duration_s=duration_s,
        size=size_of(size),
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
        "heading": next(name for name, source in HEADINGS.items() if source == hidden.yaw_from),
        "drive_type": drive_type,
        "size": size_of(size),
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

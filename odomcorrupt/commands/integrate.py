"""odomcorrupt integrate: wheel odometry from velocities alone."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from odomcorrupt.commands._bag import ODOM_TOPIC, unpack_option
from odomcorrupt.commands._options import PICTURE, setting, usage_errors, valued
from odomcorrupt.commands._standard import (
    Console,
    chosen_output,
    output_option,
    overwrite_option,
    standard_options,
    typed_words,
    written,
)
from odomcorrupt.errors import ModelError, TopicError
from odomcorrupt.result_files import refuse_existing

_BAG = click.Path(path_type=Path)


@click.command("integrate", short_help="Integrate a bag's velocities to odometry, with or without noise on them.")
@click.argument("input_", metavar="INPUT", type=_BAG)
@click.argument("output", metavar="[OUTPUT]", type=_BAG, required=False)
@output_option()
@valued(
    "--integrate", "rule", among=["euler", "midpoint", "exact"], default="exact",
    text="Integration rule: initial heading of an interval, middle heading, or arc.",
)  # fmt: skip
@valued("--hold", among=["next", "previous"], text="A twist holds until the next stamp, or from the previous one.")
@setting("--twist-noise", nargs=2, type=float, metavar="V OMEGA", help="White noise on every twist: m/s and rad/s.")
@valued("--runs", kind=click.IntRange(1, 100_000), default=1, text="How many noisy runs to draw.")
@setting("--seed", type=click.IntRange(0), metavar="N", help="Seed of the noise. [default: drawn, and printed]")
@setting(*ODOM_TOPIC, metavar="TOPIC", help="Odometry whose twists are taken.")
@setting("--truth", metavar="TOPIC", help="Poses to compare with. [default: a topic named like a truth]")
@click.option("--plot", type=PICTURE, help="Picture: .png, .svg or .pdf.")
@overwrite_option("existing outputs", passed=True)
@unpack_option
@standard_options
def command(input_: Path, output: Path | None, output_option: str | None, *, console: Console, **given: Any) -> None:
    """Integrate the velocities of a bag's odometry, and write them as its poses.

    OUTPUT gets run 0, in the Odometry messages and the TF edges that go with them; everything else stays.

    \b
    odomcorrupt integrate in.mcap out.mcap --integrate euler --plot errors.png
    odomcorrupt integrate in.mcap --twist-noise 0.2 0.04 --runs 100 --plot runs.png
    """  # noqa: D301 - click wants a real backspace
    from odomcorrupt.api.bag_options import drive_path
    from odomcorrupt.api.integration import integrate
    from odomcorrupt.bags.open import form_of, open_reader

    if output is not None or output_option is not None:
        output = Path(chosen_output(None if output is None else str(output), output_option))
    overwrite, plot = given.pop("overwrite"), given.pop("plot")
    refuse_existing(output, overwrite=overwrite)
    if output is not None:  # refuse a name that is not that of a bag before any work is done
        with open_reader(drive_path(input_)) as reader:
            form_of(drive_path(output), reader)
    with usage_errors(ModelError):
        result = integrate(input_, **given)
    if output is not None:
        result = result.then("odomcorrupt", "info", output)
    elif plot is None:
        result = result.then("odomcorrupt", "integrate", *typed_words(), "--plot", "errors.png")

    def save(path: Path) -> str:
        done = result.save(path, overwrite=overwrite)
        return f"wrote {path}: {done.messages} odometry messages, {done.transforms} transforms"

    with usage_errors(TopicError):
        console.show(result, files={**written(output, save), **written(plot, result.plot)})

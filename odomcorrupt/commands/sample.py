"""odomcorrupt sample: end poses of one motion, or poses of a robot along a whole drive."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._bag import ODOM_TOPIC, unpack_option
from odomcorrupt.commands._model import (
    AlphaCommand,
    choose_condition,
    choose_model,
    choose_move,
    map_options,
    move_options,
)
from odomcorrupt.commands._options import PICTURES, OutputFile, kind_of, number, seed_option, setting, usage_errors
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, typed_words, written
from odomcorrupt.errors import ModelError
from odomcorrupt.result_files import write_file

if TYPE_CHECKING:
    from odomcorrupt.api.motion import Particles, Samples


_RESULT = OutputFile(*PICTURES, "csv", "json")


@click.command("sample", cls=AlphaCommand, short_help="Sample the end poses of one motion (the banana-shaped cloud).")
@click.argument("bag", metavar="[BAG]", type=click.Path(path_type=Path), required=False)
@click.option("-o", "--output", "--plot", "output", type=_RESULT, help="Result: .png, .svg, .pdf, .csv or .json.")
@move_options
@map_options
@click.option(
    "--every",
    type=number("metres", 0.0, 1e6, above=True),
    metavar="M",
    help="Along a bag: distance between clouds, metres.",
)
@setting(*ODOM_TOPIC, metavar="TOPIC", help="Along a bag: odometry topic.")
@seed_option
@overwrite_option()
@unpack_option
@standard_options
def command(bag: Path | None, output: Path | None, *, console: Console, **given: Any) -> None:
    """Sample the end poses of one motion or, with a BAG, the robot's poses along its drive.

    \b
    odomcorrupt sample -o banana.png                             # the article's example
    odomcorrupt sample --law article-code -o listing.png         # its listing, unmodified
    odomcorrupt sample --example rotation-heavy -o heavy.svg     # one of the lecture's settings
    odomcorrupt sample --end 1,0.3,20deg --alpha 0.05 0.02 0.05 0.01 -n 5000 -o ends.csv
    odomcorrupt sample drive.mcap -n 500 -o cloud.png            # the cloud spreading along a drive
    odomcorrupt sample drive.mcap --map map.yaml -o cloud.png    # the same within free space
    """  # noqa: D301 - click wants a real backspace
    from odomcorrupt.api.motion import sample, sample_along
    from odomcorrupt.trajectories import read_drive

    following = ["sample", *typed_words(), "-o", "banana.png" if bag is None else "cloud.png"]
    drawn: Samples | Particles
    if bag is None:
        asked = choose_move(given) | {"within": choose_condition(given, None, "odom")}
        with usage_errors(ModelError):
            drawn = sample(**asked, seed=given["seed"])
        if output is not None:
            following = ["density", *typed_words("--every", "--odom-topic", "--max-unpacked")]
    else:
        taken = [name for name in ("example", "start", "end") if given[name] is not None]
        if taken:
            raise click.UsageError(f"--{taken[0]}: the motion is that of {bag}; leave it out")
        model, topic = choose_model(given), given["odom_topic"]
        frame = "odom" if given["map_"] is None else read_drive(bag, topic).frame_id
        asked = {"runs": given["count"] or 300, "every_m": given["every"], "odom_topic": topic}
        drawn = sample_along(bag, model, **asked, seed=given["seed"], within=choose_condition(given, bag, frame))
        for sentence in drawn.notes:
            console.note(sentence)
        if output is not None:
            following = ["preview", str(bag)]

    def write(path: Path) -> None:
        if kind_of(path) in PICTURES:
            drawn.plot(path)
        elif kind_of(path) == "csv":
            write_file(path, drawn.csv())
        else:
            values = drawn.to_dict()
            del values["schema"]
            write_file(path, json.dumps(values, indent=1) + "\n")

    shown = drawn.then("odomcorrupt", *following)
    console.show(shown, files=written(output, write))

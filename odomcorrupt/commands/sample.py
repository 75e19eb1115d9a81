"""odomcorrupt sample: end poses of one motion, or poses of a robot along a whole drive."""

from __future__ import annotations

import json
import math
import shlex
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._bag import ODOM_TOPIC, unpack_option
from odomcorrupt.commands._map import choose_condition, map_options
from odomcorrupt.commands._model import AlphaCommand, choose_model, choose_move, move_options
from odomcorrupt.commands._options import PICTURES, Number, OutputFile, kind_of, save_picture, usage_errors
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, typed_words, written
from odomcorrupt.errors import ModelError, OdomCorruptError
from odomcorrupt.result_files import write_text

if TYPE_CHECKING:
    from collections.abc import Mapping


_RESULT = OutputFile(*PICTURES, "csv", "json")
_RUNS = 300
"""Default number of runs along a bag."""


def _sample_along(bag: Path, output: Path | None, *, console: Console, given: Mapping[str, Any]) -> None:
    """Draw runs of a bag's drive, evaluate them at distances along it, and print and write the result."""
    from odomcorrupt.corruption.summary import model_brief
    from odomcorrupt.mapping.conditioned_runs import free_paths
    from odomcorrupt.rng import draw_seed
    from odomcorrupt.sampling.particles import (
        brief,
        csv_text,
        particles_at,
        particles_json,
        places_along,
        report_text,
        sample_particles,
    )
    from odomcorrupt.trajectories import read_drive

    taken = [name for name in ("example", "start", "end") if given[name] is not None]
    if taken:
        raise click.UsageError(f"--{taken[0]}: the motion is that of {bag}; leave it out")
    if str(bag) == "-":
        raise OdomCorruptError("-: the whole drive is read first, which is impossible on a pipe; name a file")
    chosen = choose_model(given)
    drive = read_drive(bag, given["odom_topic"])
    # about six particle sets, at round distances
    every = given["every"] or _round(float(drive.distance_m[-1]) / 6.0)
    seed = draw_seed() if given["seed"] is None else given["seed"]
    runs = given["count"] or _RUNS
    condition = choose_condition(given, bag, drive.frame_id)
    if condition is None:
        cloud = sample_particles(drive, chosen.motion_model, seed=seed, runs=runs, every_m=every)
    else:
        places = places_along(drive, every)
        free = free_paths(
            drive.stamps_ns, drive.xyt, chosen.motion_model, condition, seed=seed, runs=range(runs), places=places
        )  # fmt: skip
        cloud = particles_at(drive, places, free.xyt, seed)
        console.note(free.account())
    origin = f" ({chosen.origin})" if chosen.origin else ""
    text = f"noise: {chosen.motion_model.noise.words}{origin}\n{report_text(cloud)}"
    values = particles_json(cloud)

    def write(path: Path) -> None:
        if kind_of(path) not in PICTURES:
            as_json = json.dumps(values, indent=1) + "\n"
            write_text(path, csv_text(cloud) if kind_of(path) == "csv" else as_json)
            return
        from odomcorrupt.report.plots.samples import draw_cloud

        law = chosen.motion_model.noise.law_name
        within = "" if condition is None else " within the map"
        space = None if condition is None else condition.space
        save_picture(path, draw_cloud(cloud, f"Where the robot may be{within}: law {law}, seed {seed}", space))

    following = ["odomcorrupt", "sample", *typed_words("--output", "--overwrite"), "-o", "cloud.png"]
    if output is not None:
        following = ["odomcorrupt", "preview", str(bag)]
    words = model_brief(chosen.motion_model, chosen.origin.partition(":")[0])
    said = brief(cloud, words, f"{drive.topic} of {bag}", following)
    console.print(said, text, {"schema": 2, **values}, files=written(output, write))


def _round(value: float) -> float:
    """Return the smallest of 1, 2 or 5 times a power of ten that is not below a value."""
    power = 10.0 ** math.floor(math.log10(max(value, 1e-6)))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= 0.999 * value)


@click.command("sample", cls=AlphaCommand, short_help="Sample the end poses of one motion (the banana-shaped cloud).")
@click.argument("bag", metavar="[BAG]", type=click.Path(path_type=Path), required=False)
@click.option("-o", "--output", type=_RESULT, help="Result: .png, .svg, .pdf, .csv or .json.")
@move_options
@map_options
@click.option(
    "--every",
    type=Number("metres", 0.0, 1e6, above=True),
    metavar="M",
    help="Along a bag: distance between clouds, metres.",
)
@click.option(*ODOM_TOPIC, metavar="TOPIC", help="Along a bag: odometry topic.")
@click.option("--seed", type=click.IntRange(0), metavar="N", help="Seed of all draws. [default: drawn, and printed]")
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
    from odomcorrupt.api.motion import sample

    if bag is not None:
        _sample_along(bag, output, console=console, given=given)
        return
    chosen = choose_move(given)
    condition = choose_condition(given, None, "odom")
    with usage_errors(ModelError):
        asked = {"count": chosen.count, "seed": given["seed"], "within": condition}
        drawn = sample(chosen.start_xyt, chosen.end_xyt, model=chosen.model, **asked)

    def write(path: Path) -> None:
        if kind_of(path) in PICTURES:
            drawn.plot(path)
        else:
            values = drawn.to_dict()
            del values["schema"]
            as_json = json.dumps(values, indent=1) + "\n"
            write_text(path, drawn.csv() if kind_of(path) == "csv" else as_json)

    following = ["sample", *typed_words("--output", "--overwrite"), "-o", "banana.png"]
    if output is not None:
        following = ["density", *typed_words("--output", "--overwrite", "--every", "--odom-topic", "--max-unpacked")]
    shown = replace(drawn, following=shlex.join(["odomcorrupt", *following]))
    console.show(shown, files=written(output, write))

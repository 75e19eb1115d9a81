"""`odomcorrupt sample in.mcap`: where a robot may be along a whole drive."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._map import choose_condition
from odomcorrupt.commands._model import choose_model
from odomcorrupt.commands._motion_options import MODEL_OPTIONS
from odomcorrupt.commands._poses import PICTURES, save_picture
from odomcorrupt.files import write_text

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from odomcorrupt.commands._standard import Voice

__all__ = ["DEFAULT_RUNS", "sample_along"]

DEFAULT_RUNS = 300


def sample_along(bag: Path, output: Path | None, kind: str | None, *, voice: Voice, given: Mapping[str, Any]) -> None:
    """Draw runs of a bag's drive, look at them along the way, and print and write what is asked for."""
    from odomcorrupt.errors import OdomCorruptError
    from odomcorrupt.mapping.conditioned_runs import free_paths
    from odomcorrupt.rng import draw_seed
    from odomcorrupt.sampling.text import law_words
    from odomcorrupt.trajectories.particles import cloud_along, cloud_of, csv_text, json_text, places_along, report_text
    from odomcorrupt.trajectories.reader import read_drive

    taken = [name for name in ("example", "start", "end") if given[name] is not None]
    if taken:
        raise click.UsageError(f"--{taken[0]}: the motion is that of {bag}; leave it out")
    if str(bag) == "-":
        raise OdomCorruptError("-: the whole drive is read first, which a pipe cannot do; name a file")
    options: dict[str, Any] = {name: given.get(name) for name in MODEL_OPTIONS}
    chosen = choose_model(**options)
    drive = read_drive(bag, given["odom_topic"])
    # about six clouds, at round distances
    every = given["every"] or _round(float(drive.distance_m[-1]) / 6.0)
    seed = draw_seed() if given["seed"] is None else given["seed"]
    runs = given["count"] or DEFAULT_RUNS
    condition = choose_condition(given, bag, drive.frame_id)
    if condition is None:
        cloud = cloud_along(drive, chosen.motion_model, seed=seed, runs=runs, every_m=every)
    else:
        places = places_along(drive, every)
        free = free_paths(
            drive.stamps_ns, drive.xyt, chosen.motion_model, condition.space, seed=seed, runs=range(runs),
            places=places, check=condition.check, tries=condition.tries,
        )  # fmt: skip
        cloud = cloud_of(drive, places, free.xyt, seed)
        voice.note(free.account())
    origin = f" ({chosen.origin})" if chosen.origin else ""
    text = f"noise: {law_words(chosen.motion_model.noise)}{origin}\n{report_text(cloud)}"
    voice.say(text, text, {"schema": 2, **json.loads(json_text(cloud))})
    if output is None:
        return
    if kind in PICTURES:
        from odomcorrupt.report.plots.particles import draw_cloud

        law = chosen.motion_model.noise.law_name
        within = "" if condition is None else " within the map"
        space = None if condition is None else condition.space
        save_picture(output, draw_cloud(cloud, f"Where the robot may be{within}: law {law}, seed {seed}", space))
        return
    write_text(output, csv_text(cloud) if kind == ".csv" else json_text(cloud))
    voice.note(f"wrote {output}")


def _round(value: float) -> float:
    """Return 1, 2 or 5 times a power of ten, the nearest from above."""
    import math

    power = 10.0 ** math.floor(math.log10(max(value, 1e-6)))
    return next(step * power for step in (1.0, 2.0, 5.0, 10.0) if step * power >= 0.999 * value)

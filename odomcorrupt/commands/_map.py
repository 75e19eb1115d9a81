"""Options that say which map a motion must respect."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._poses import POSE

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from odomcorrupt.mapping.free_space import Check, FreeSpace

__all__ = ["Condition", "choose_condition", "map_options"]


@dataclass(frozen=True, slots=True)
class Condition:
    """Free space, how a motion is held against it, and how often it is drawn."""

    space: FreeSpace
    check: Check
    tries: int


def map_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of `choose_condition`."""
    for option in (
        click.option(
            "--max-tries", "tries", type=click.IntRange(1, 1_000_000), default=100, help="Per motion. [default: 100]"
        ),
        click.option(
            "--unknown",
            type=click.Choice(["blocked", "free"]),
            default="blocked",
            help="Whether the robot may be where the map knows nothing. [default: blocked]",
        ),
        click.option(
            "--map-check",
            "check",
            type=click.Choice(["endpoint", "path"]),
            default="endpoint",
            help="Where a motion ends must be free, or all its way. [default: endpoint]",
        ),
        click.option(
            "--robot-radius", "radius", type=click.FloatRange(min=0.0), default=0.2, help="Metres. [default: 0.2]"
        ),
        click.option(
            "--map-pose", type=POSE, help="Odom frame in the map. [default: TF of the bag; without one 0,0,0]"
        ),
        click.option(
            "--map", "map_", metavar="MAP", help="Draw free poses only: a map's .yaml, or a topic of the bag."
        ),
    ):
        command = option(command)
    return command


def choose_condition(given: Mapping[str, Any], bag: Path | None, odom_frame: str) -> Condition | None:
    """Return what the options ask for, None where they name no map."""
    import numpy as np

    from odomcorrupt.errors import MapError
    from odomcorrupt.mapping.free_space import free_space
    from odomcorrupt.mapping.mapfile import read_map
    from odomcorrupt.mapping.recorded import read_map_from_odom, read_recorded_map

    name = given["map_"]
    if name is None:
        if given["map_pose"] is not None:
            raise click.UsageError("--map-pose: says where odom is in a map; name the map with --map")
        return None
    frame = "map"
    if name.endswith((".yaml", ".yml")):
        grid = read_map(Path(name))
    elif bag is None:
        raise click.UsageError(f"--map {name}: without a bag a map is a .yaml file")
    else:
        grid, frame = read_recorded_map(bag, name)
    pose = np.zeros(3) if given["map_pose"] is None else np.array(given["map_pose"])
    if given["map_pose"] is None and bag is not None and frame.lstrip("/") != odom_frame.lstrip("/"):
        found = read_map_from_odom(bag, frame, odom_frame)
        if found is None:
            raise MapError(
                f"{bag}: TF has nothing between {frame!r} and {odom_frame!r}; say where odom is in the map with "
                "--map-pose x,y,yaw (0,0,0 where they are the same)"
            )
        pose = found
    space = free_space(grid, given["radius"], unknown=given["unknown"], map_from_odom=pose)
    return Condition(space, given["check"], given["tries"])

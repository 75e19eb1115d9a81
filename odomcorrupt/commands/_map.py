"""Options that say which map a motion must respect."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from odomcorrupt.commands._param_types import Number
from odomcorrupt.commands._poses import POSE

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.mapping.map_condition import MapCondition

__all__ = ["choose_condition", "choose_condition_of_run", "map_options"]


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
            "--robot-radius", "radius", type=Number("metres", 0.0, 100.0), default=0.2, help="Metres. [default: 0.2]"
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


def choose_condition(
    given: Mapping[str, Any], bag: Path | None, odom_frame: str, *, recover: bool = False
) -> MapCondition | None:
    """Return what the options ask for, None where they name no map."""
    from odomcorrupt.mapping.map_condition import is_map_file, read_condition

    name = given["map_"]
    if name is None:
        _refuse_alone(given)
        return None
    if bag is None and not is_map_file(name):
        raise click.UsageError(f"--map {name}: without a bag a map is a .yaml file")
    return read_condition(
        name,
        bag=bag,
        odom_frame=odom_frame,
        map_pose=given["map_pose"],
        radius_m=given["radius"],
        unknown=given["unknown"],
        check=given["check"],
        tries=given["tries"],
        recover=recover,
    )


def choose_condition_of_run(given: Mapping[str, Any], source: Path | None, options: Options) -> MapCondition | None:
    """Return what the options ask of the corruption of a bag, None where they name no map; a source of None is a pipe.

    Raises
    ------
    click.UsageError
        Where a pipe would have to be read twice, or the map has nothing to hold.
    MapError
        Where the map cannot be read, or nothing says where odom is in it.

    """
    name = given["map_"]
    if name is None:
        _refuse_alone(given)
        return None
    from odomcorrupt.mapping.map_condition import is_map_file, read_odom_frame

    if options.keep_localisation:
        raise click.UsageError(
            "--map and --keep-localisation: with map -> base kept true nothing in the map is drawn; leave out one"
        )
    if source is None and (given["map_pose"] is None or not is_map_file(name)):
        raise click.UsageError(
            f"--map {name}: INPUT is a pipe and read once; name a map's .yaml, and say with --map-pose where odom is "
            "in it"
        )
    frame = ""
    if source is not None and given["map_pose"] is None:
        frame = read_odom_frame(source, options, recover=given["recover"])
    return choose_condition(given, source, frame, recover=given["recover"])


def _refuse_alone(given: Mapping[str, Any]) -> None:
    """Refuse options that say more of a map, where none is named."""
    context = click.get_current_context()
    for option in context.command.params:
        of_map = option.name in ("map_pose", "radius", "check", "unknown", "tries") and option.name in given
        if of_map and context.get_parameter_source(option.name or "") is ParameterSource.COMMANDLINE:
            raise click.UsageError(f"{option.opts[0]}: says more of a map; name the map with --map")

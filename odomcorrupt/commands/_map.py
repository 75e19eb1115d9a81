"""Options of the map that constrains a motion."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from odomcorrupt.commands._options import POSE, Number, added, one_of, setting

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from odomcorrupt.corruption.transform import Options
    from odomcorrupt.mapping.conditioned import MapCondition
    from odomcorrupt.model.motion_model import MotionModel


map_options = added(
    click.option("--map", "map_", metavar="MAP", help="Draw free poses only: a map's .yaml, or a topic of the bag."),
    setting(
        "--map-pose", type=POSE, help="Pose of the odom frame in the map. [default: TF of the bag; without a bag 0,0,0]"
    ),
    setting(
        "--robot-radius",
        "radius",
        type=Number("metres", 0.0, 100.0),
        default=0.2,
        help="Radius of the robot, metres. [default: 0.2]",
    ),
    one_of(
        "--map-check",
        "check",
        among=["endpoint", "path"],
        text="Cells that must be free: at the end of each motion, or along it.",
    ),
    one_of("--unknown", among=["blocked", "free"], text="Treat unknown cells of the map as blocked or as free."),
    click.option(
        "--max-tries", "tries", type=click.IntRange(1, 1_000_000), default=100, help="Draws per motion. [default: 100]"
    ),
)
"""Adds the options of `choose_condition`."""


def choose_condition(
    given: Mapping[str, Any], bag: Path | None, odom_frame: str, *, recover: bool = False
) -> MapCondition | None:
    """Return the map condition of the options, None if they name no map."""
    from odomcorrupt.mapping.conditioned import is_map_file, read_condition

    name = given["map_"]
    if name is None:
        _refuse_alone(given)
        return None
    if bag is None and not is_map_file(name):
        raise click.UsageError(f"--map {name}: without a bag a map is a .yaml file")
    asked = {key: given[key] for key in ("map_pose", "unknown", "check", "tries")}
    return read_condition(name, bag=bag, odom_frame=odom_frame, radius_m=given["radius"], recover=recover, **asked)


def choose_condition_of_run(
    given: Mapping[str, Any], source: Path | None, options: Options, model: MotionModel
) -> MapCondition | None:
    """Return the map condition for the corruption of a bag, None if no map is named; a source of None is a pipe.

    Raises
    ------
    click.UsageError
        If a pipe would have to be read twice, or --keep-localisation leaves no noise for the map to constrain.
    MapError
        If the map cannot be read, or the pose of odom in it is unknown.
    """
    name = given["map_"]
    if name is None:
        _refuse_alone(given)
        return None
    from odomcorrupt.mapping.conditioned import is_map_file, read_odom_frame

    if options.keep_localisation:
        raise click.UsageError(
            "--map and --keep-localisation: with map -> base kept true the drift does not move the robot in the map; "
            "leave out one"
        )
    if source is None and (given["map_pose"] is None or not is_map_file(name)):
        raise click.UsageError(
            f"--map {name}: INPUT is a pipe and read once; name a map's .yaml, and give the pose of odom in it with "
            "--map-pose"
        )
    frame = ""
    if source is not None and given["map_pose"] is None:
        frame = read_odom_frame(source, options, model.odometry_topic, recover=given["recover"])
    return choose_condition(given, source, frame, recover=given["recover"])


def _refuse_alone(given: Mapping[str, Any]) -> None:
    """Refuse options about a map if none is named."""
    context = click.get_current_context()
    for option in context.command.params:
        of_map = option.name in ("map_pose", "radius", "check", "unknown", "tries") and option.name in given
        if of_map and context.get_parameter_source(option.name or "") is ParameterSource.COMMANDLINE:
            raise click.UsageError(f"{option.opts[0]}: needs a map; name it with --map")

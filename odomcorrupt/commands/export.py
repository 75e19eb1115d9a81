"""odomcorrupt export: a model's numbers as parameters of other programs."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._options import FILE, MODELS, OUTPUT, TRACK, Decorator, number, setting, usage_errors, valued
from odomcorrupt.commands._standard import Console, overwrite_option, standard_options, written
from odomcorrupt.errors import ModelError

if TYPE_CHECKING:
    from pathlib import Path

    from odomcorrupt.api.model import Target

_EVERY = "nothing would let amcl update at every scan"


def _number(
    word: str, unit: str, metavar: str, default: float, text: str, *, high: float = 1e3, **bounds: Any
) -> Decorator:
    """Return an option that takes a number of zero or more."""
    return valued(word, kind=number(unit, 0.0, high, **bounds), default=default, metavar=metavar, text=text)


@click.command("export", short_help="Print a model as parameters of ros2_control, nav2, robot_localization or Gazebo.")
@click.argument("model", type=FILE, shell_complete=MODELS)
@click.option(
    "--to", "target", type=click.Choice(["ros2_control", "nav2", "robot_localization", "gazebo"]),
    help="Wheel multipliers, amcl's alphas, covariances, or a drive plugin.",
)  # fmt: skip
@setting(
    "--track", "track_m", type=TRACK, metavar="M", help="Nominal distance between the wheels. [default: the model's]"
)
@click.option(
    "--wheelbase", "wheelbase_m", type=TRACK, metavar="M", help="Distance between the axles, omni or steered base."
)
@click.option(
    "--wheel-radius", "wheel_radius_m", metavar="M", help="Nominal radius of the wheels.",
    type=number("metres of a wheel's radius", 0.0, 1.5, above=True, else_="3.5 cm are 0.035"),
)  # fmt: skip
@_number("--update-min-d", "metres", "M", 0.25, "amcl's update distance.", above=True, else_=_EVERY)
@_number("--update-min-a", "radians", "RAD", 0.2, "amcl's update angle.", above=True, else_=_EVERY)
@valued(
    "--turn", among=["rolling", "spot"],
    text="Turn on which amcl's noise is matched to the model's: along an arc, or on the spot.",
)  # fmt: skip
@_number("--speed", "m/s", "M/S", 0.5, "Speed at which the noise is evaluated.")
@_number("--turn-rate", "rad/s", "RAD/S", 0.5, "Turn rate at which the noise is evaluated.")
@_number("--rate", "messages per second", "HZ", 50.0, "Rate of odometry messages.", above=True, high=1e6)
@click.option("--controller", metavar="NAME", help="Name of the node. [default: the controller for this base]")
@click.option("-o", "--output", type=OUTPUT, help="Write YAML or SDF to a file.")
@overwrite_option()
@standard_options
def command(model: Path, *, target: Target | None, output: Path | None, console: Console, **given: Any) -> None:
    """Print a model's parameters as YAML or SDF for another program.

    -v adds comments: assumptions, and effects that the program cannot express. -o writes all of it to a file.
    Dimensions come from wheel_scale, unequal_wheels, wheelbase and steering_scale; alphas and covariances from the law.
    """
    from odomcorrupt.api.model import as_model, export_parameters

    if target is None:
        raise click.UsageError("--to: says which program; give --to ros2_control, nav2, robot_localization or gazebo")
    robot = as_model(str(model))
    with usage_errors(ModelError):
        result = export_parameters(robot, target, **given)
    if target == "nav2" and not result.result.values["alpha1"]:
        console.note("alpha1 is 0: amcl's particles then have no spread from turns; write 1e-4 or more")
    if output is None:
        console.print(result.result.condensed(), result.details(), result.to_dict())
        return
    controller = result.result.lines[0].rstrip(":")
    load = {
        "nav2": "ros2 run nav2_amcl amcl --ros-args --params-file",
        "ros2_control": f"ros2 run controller_manager spawner {controller} --param-file",
        "robot_localization": "ros2 run robot_localization ekf_node --ros-args --params-file",
    }
    words = [*load[target].split(), output] if target in load else []
    files = written(output, lambda path: result.save(path, overwrite=True))
    console.show(replace(result, name=model.name).then(*words), files=files)

"""odomcorrupt export: a model's numbers as parameters of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from odomcorrupt.commands._param_types import TRACK, Number
from odomcorrupt.commands._standard import standard_options

if TYPE_CHECKING:
    from odomcorrupt.commands._standard import Voice
    from odomcorrupt.export.nav2 import Turn

__all__ = ["command"]

_EVERY = "nothing would let amcl update at every scan"


@click.command("export", short_help="Print a model as parameters of ros2_control, nav2 or robot_localization.")
@click.argument("model", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--to",
    "target",
    type=click.Choice(["ros2_control", "nav2", "robot_localization"]),
    required=True,
    help="Wheel multipliers, amcl's alphas, or covariances.",
)
@click.option("--track", type=TRACK, metavar="M", help="Nominal distance between the wheels. [default: the model's]")
@click.option(
    "--update-min-d",
    type=Number("metres", 0.0, 1e3, above=True, else_=_EVERY),
    default=0.25,
    show_default=True,
    metavar="M",
    help="Of amcl.",
)
@click.option(
    "--update-min-a",
    type=Number("radians", 0.0, 1e3, above=True, else_=_EVERY),
    default=0.2,
    show_default=True,
    metavar="RAD",
    help="Of amcl.",
)
@click.option(
    "--turn",
    type=click.Choice(["rolling", "spot"]),
    default="rolling",
    show_default=True,
    help="The turn on which amcl is to agree with the model: along an arc, or on the spot.",
)
@click.option(
    "--speed",
    type=Number("m/s", 0.0, 1e3),
    default=0.5,
    show_default=True,
    metavar="M/S",
    help="For what depends on it.",
)
@click.option(
    "--turn-rate", type=Number("rad/s", 0.0, 1e3), default=0.5, show_default=True, metavar="RAD/S", help="Likewise."
)
@click.option(
    "--rate",
    type=Number("messages per second", 0.0, 1e6, above=True),
    default=50.0,
    show_default=True,
    metavar="HZ",
    help="Of odometry messages.",
)
@click.option("--controller", default="diff_drive_controller", show_default=True, metavar="NAME", help="Node to set.")
@standard_options
def command(
    model: Path,
    *,
    target: str,
    track: float | None,
    update_min_d: float,
    update_min_a: float,
    turn: Turn,
    speed: float,
    turn_rate: float,
    rate: float,
    controller: str,
    voice: Voice,
) -> None:
    """Print a model as YAML to paste; -v adds what it assumes and cannot express, in comments.

    Wheel multipliers come from wheel_scale, unequal_wheels and wheelbase; alphas and covariances from the noise law.
    """
    from odomcorrupt.errors import ModelError
    from odomcorrupt.export.nav2 import amcl_alphas
    from odomcorrupt.export.robot_localization import Steady, twist_variances
    from odomcorrupt.export.ros2_control import wheel_multipliers
    from odomcorrupt.export.yaml_text import amcl_text, twists_text, wheels_text, without_comments
    from odomcorrupt.model.model_file import read_model

    robot = read_model(model)
    if target == "ros2_control":
        text = wheels_text(robot, wheel_multipliers(robot, track), controller)
        voice.say(without_comments(text, robot), text, {"schema": 2, "to": target, "yaml": text})
        return
    try:
        drive = Steady(speed, turn_rate, rate)
        if target == "nav2":
            alphas = amcl_alphas(robot.noise, update_min_d, update_min_a, turn=turn, drive=drive)
            text = amcl_text(robot, alphas, update_min_d, update_min_a, turn)
        else:
            text = twists_text(robot, twist_variances(robot.noise, drive), drive, controller)
    except ModelError as error:
        raise click.UsageError(str(error)) from error
    voice.say(without_comments(text, robot), text, {"schema": 2, "to": target, "yaml": text})

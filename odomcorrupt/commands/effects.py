"""odomcorrupt effects: descriptions of the causes of odometry errors."""

from __future__ import annotations

import click

from odomcorrupt.commands._options import EFFECTS
from odomcorrupt.commands._standard import Console, standard_options


@click.command("effects", short_help="List the physical effects, or explain one.")
@click.argument("name", required=False, shell_complete=EFFECTS)
@standard_options
def command(name: str | None, *, console: Console) -> None:
    """List the physical effects that make odometry depart from the truth, or explain one of them.

    --effect NAME:parameter=value adds an effect to a bag, diagnose tests for it, and correct removes it.

    \b
    An effect of your own is an expression in a model file, a rate added to truth minus odometry:
      [[effect]]
      name = "my_bumps"
      expression = "yaw += k * v * abs(omega)"
      k = 0.01
    channels    along, across (m/s), yaw (rad/s); several statements with ; between
    wheels      left, right, wheels (m/s of the rim): v, a, x and y are then the wheel's own
    variables   v, vy, omega, a, alpha, t, x, y, theta, distance, pi, and your parameters
    functions   sin cos tan exp log sqrt tanh abs sign atan2 hypot min max where(a > b, yes, no)
    """  # noqa: D301 - click wants a real backspace
    from odomcorrupt.api.catalogue import describe_effect, list_effects

    console.show(list_effects() if name is None else describe_effect(name))

"""odomcorrupt convert-alpha: coefficients of one law converted to another."""

from __future__ import annotations

import click

from odomcorrupt.commands._options import usage_errors
from odomcorrupt.commands._standard import Console, standard_options
from odomcorrupt.errors import ModelError


@click.command("convert-alpha", short_help="Convert the alphas of one noise law to another.")
@click.argument("alphas", nargs=-1, required=True, metavar="A1 A2 A3 A4")
@click.option(
    "--from", "source", required=True, metavar="LAW", help="Law of these alphas: diffusion, linear, quadratic."
)
@click.option("--to", "target", required=True, metavar="LAW", help="Law to convert them to.")
@click.option("--step", metavar="STEP", help="Step of a step-dependent law, as in 0.25m or 0.25m,0.2rad.")
@click.option("--to-step", metavar="STEP", help="Step of the other law. [default: the same]")
@standard_options
def command(
    alphas: tuple[str, ...], *, source: str, target: str, step: str | None, to_step: str | None, console: Console
) -> None:
    """Convert the alphas of one law to another that drifts the same on straight drives and on turns.

    The book laws depend on the step they are applied to: amcl applies its one per update_min_d, a corrupted bag per
    message unless --step says otherwise.

    \b
    odomcorrupt convert-alpha 0.2 0.2 0.2 0.2 --from quadratic --step 0.25m \\
        --to diffusion
    odomcorrupt convert-alpha 5deg 2deg/m 0.05 0.01 --from diffusion \\
        --to quadratic --to-step 0.25m,0.2rad
    """  # noqa: D301 - click wants a real backspace
    from odomcorrupt.api.model import Noise, convert_alpha

    with usage_errors(ModelError):
        console.show(convert_alpha(Noise(alpha=alphas, law=source, step=step), target, step=to_step))

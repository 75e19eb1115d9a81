"""odomcorrupt convert-alpha: coefficients of one law converted to another."""

from __future__ import annotations

import dataclasses
import math
from typing import TYPE_CHECKING, Any

import click

from odomcorrupt.commands._options import usage_errors
from odomcorrupt.commands._standard import Console, standard_options
from odomcorrupt.errors import ModelError
from odomcorrupt.summary import Line, Summary, command_line

if TYPE_CHECKING:
    from odomcorrupt.model.motion_model import Noise, Step


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
    from odomcorrupt.model.motion_model import Noise, parse_alpha
    from odomcorrupt.model.noise_laws import law_named
    from odomcorrupt.sampling.convert import convert

    with usage_errors(ModelError):
        law, other = law_named(source), law_named(target)
        before = Noise(
            source, law.coefficients([parse_alpha(a) for a in alphas]), _step(step) if law.per_step else None
        )
        after = convert(before, other, _step(to_step or step) if other.per_step else None)
    console.print(_brief(before, after), _text(before, after), _values(before, after))


def _step(text: str | None) -> Step | None:
    from odomcorrupt.model.motion_model import Step

    return None if text is None else Step.parse(text)


def _brief(before: Noise, after: Noise) -> Summary:
    """Return the coefficients of the other law, the drift of both, and how to use them."""
    from odomcorrupt.corruption.summary import model_brief
    from odomcorrupt.model.motion_model import MotionModel
    from odomcorrupt.sampling.text import law_meaning

    straight, turn = _drifts(after)
    new, old = (f"{model_brief(MotionModel(noise), '')}; {law_meaning(noise)}" for noise in (after, before))
    lines = [Line("CONVERTED", new, "good"), Line("from", old), Line("10 m", f"{straight} (1 sigma, both laws)")]
    lines.append(Line("360 deg", f"on the spot: {turn} (1 sigma, both laws)"))
    return Summary((*lines, command_line(f"odomcorrupt in.bag out.bag {_flags(after)}")))


def _flags(noise: Noise) -> str:
    """Return the options that select a noise."""
    values = [getattr(noise.coefficients, name) for name in noise.law.alphas]
    while len(values) > 4 and not values[-1]:  # the first four must be typed
        values.pop()
    alphas = " ".join(f"{value:.6g}" for value in values)
    return f"--law {noise.law_name} --alpha {alphas}{f' --step {noise.step}' if noise.step is not None else ''}"


def _drifts(noise: Noise) -> tuple[str, str]:
    """Return the standard deviations after ten metres straight, and after a whole turn on the spot, in words."""
    from odomcorrupt.sampling.convert import drift_of

    drift = drift_of(noise)
    heading, travel = math.degrees(math.sqrt(10.0 * drift.rot_trans)), math.sqrt(10.0 * drift.trans_trans)
    turned, shifted = (math.sqrt(2.0 * math.pi * variance) for variance in (drift.rot_rot, drift.trans_rot))
    return (
        f"heading {heading:.3g} deg, along {travel:.3g} m",
        f"heading {math.degrees(turned):.3g} deg, along {shifted:.3g} m",
    )


def _text(before: Noise, after: Noise) -> str:
    from odomcorrupt.sampling.text import law_words

    straight, turn = _drifts(after)
    return f"""{law_words(before)}
makes the same drift on straight drives and on turns as
{law_words(after)}
  10 m straight: {straight} (1 sigma, both)
  one turn on the spot: {turn} (1 sigma, both)
{_flags(after)}"""


def _values(before: Noise, after: Noise) -> dict[str, Any]:
    from odomcorrupt.sampling.convert import drift_of

    def side(noise: Noise) -> dict[str, Any]:
        step = None if noise.step is None else str(noise.step)
        return {"law": noise.law_name, "step": step, "coefficients": dataclasses.asdict(noise.coefficients)}

    growth = dataclasses.asdict(drift_of(after))
    return {"schema": 2, "from": side(before), "to": side(after), "variance_growth": growth}

"""Options that say which motion model to use: coefficients, presets, effects, files, seeds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from collections.abc import Callable

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.model import MotionModel

__all__ = ["Chosen", "choose_model", "model_options"]


@dataclass(frozen=True, slots=True)
class Chosen:
    """A model, and in words where its numbers come from (empty where the user typed them)."""

    model: MotionModel
    origin: str


def model_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of `choose_model`."""
    for option in (
        click.option(
            "--model", type=click.Path(dir_okay=False, path_type=Path), help="Motion model, as `fit` writes it."
        ),
        click.option(
            "--effect", "effects", multiple=True, metavar="NAME:KEY=VALUE,...", help="Systematic error (repeatable)."
        ),
        click.option("--preset", metavar="NAME", help="Ready-made numbers: typical, article. [default: typical]"),
        click.option(
            "--step",
            metavar="STEP",
            help="Apply a book law once per distance or angle, as in 0.25m,0.2rad. [default: message]",
        ),
        click.option(
            "--law", metavar="NAME", help="What the four mean: diffusion, linear, quadratic. [default: diffusion]"
        ),
        click.option(
            "--alpha", nargs=4, metavar="A1 A2 A3 A4", help="Noise: 0.05, 5deg (after 1 rad), 10deg/m (after 1 m)."
        ),
    ):
        command = option(command)
    return command


def choose_model(
    *,
    alpha: tuple[str, ...] | None,
    law: str | None,
    step: str | None,
    preset: str | None,
    effects: tuple[str, ...],
    model: Path | None,
) -> Chosen:
    """Return the model that the options describe; with no numbers at all, the default preset.

    Raises
    ------
    click.UsageError
        Where options contradict each other or one of them makes no sense.
    ModelError
        Where the model file is wrong.

    """
    from odomcorrupt.errors import ModelError
    from odomcorrupt.modelfile import read_model

    given = [name for name, value in (("--alpha", alpha), ("--preset", preset), ("--model", model)) if value]
    if len(given) > 1 and given != ["--alpha", "--model"]:
        raise click.UsageError(f"{' and '.join(given)} both bring noise; give one of them")
    if law is not None and alpha is None:
        raise click.UsageError(f"--law {law}: what coefficients mean depends on the law, so give them with --alpha")
    base = None if model is None else read_model(model)
    try:
        return _compose(alpha, law, step, preset, effects, base, model)
    except ModelError as error:
        raise click.UsageError(str(error)) from error


def _compose(
    alpha: tuple[str, ...] | None,
    law: str | None,
    step: str | None,
    preset: str | None,
    effects: tuple[str, ...],
    base: MotionModel | None,
    file: Path | None,
) -> Chosen:
    from odomcorrupt.laws import Coefficients, law_named
    from odomcorrupt.model import MotionModel, Noise, Step, parse_alpha
    from odomcorrupt.presets import DEFAULT, preset_named

    added = tuple(_effect(text) for text in effects)
    origin = ""
    if alpha is not None:
        chosen_law = law_named(law or (base.noise.law_name if base is not None else "diffusion"))
        noise = Noise(chosen_law.name, Coefficients(*(parse_alpha(text) for text in alpha)))
    elif base is not None:
        noise, origin = base.noise, f"of {file}"
    elif preset is None and added:
        noise, origin = Noise("diffusion", Coefficients(0.0, 0.0, 0.0, 0.0)), "no noise beside the effects"
    else:
        chosen = preset_named(preset or DEFAULT)
        noise, origin = chosen.noise, f"preset {chosen.name}: {chosen.source}"
    if step is not None:
        noise = replace(noise, step=Step.parse(step))
    model = MotionModel(noise) if base is None else replace(base, noise=noise)
    return Chosen(replace(model, effects=model.effects + added), origin)


def _effect(text: str) -> Effect:
    """Return the effect written as NAME:key=value,key=value; values may be degrees."""
    from odomcorrupt.effects import effect_from_values
    from odomcorrupt.errors import EffectError, ModelError
    from odomcorrupt.model import parse_alpha

    name, _, rest = text.partition(":")
    values = {}
    for part in rest.split(",") if rest else ():
        key, equals, value = part.partition("=")
        try:
            values[key.strip()] = parse_alpha(value)
        except ModelError:
            equals = ""
        if not equals:
            raise EffectError(f"--effect {text}: {part!r} is not key=number; write as in wheel_scale:e=0.01")
    return effect_from_values(name.strip(), values)

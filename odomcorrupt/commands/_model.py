"""Options that say which motion model to use: coefficients, presets, effects, files, seeds."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

if TYPE_CHECKING:
    from collections.abc import Callable

    from odomcorrupt.api.model import Model
    from odomcorrupt.model import motion_model

__all__ = ["MODEL_OPTIONS", "AlphaCommand", "choose_model", "model_options"]

MODEL_OPTIONS = ("alpha", "law", "twist_noise", "step", "preset", "effects", "model", "track")
"""What `choose_model` takes."""

MOST = 6
"""The most coefficients that any law has."""

NUMBER = re.compile(r"-?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?(deg|rad)?(/(m|rad))?\Z")


def _complete_laws(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    from odomcorrupt.model.noise_laws import LAWS

    return [name for name in LAWS if name.startswith(incomplete)]


def _complete_presets(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    from odomcorrupt.model.presets import PRESETS

    return [name for name in PRESETS if name.startswith(incomplete)]


def _complete_effects(_ctx: click.Context, _param: click.Parameter, incomplete: str) -> list[str]:
    from odomcorrupt.effects import registry

    return [name for name in registry() if name.startswith(incomplete)]


def model_options(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the options of `choose_model`."""
    for option in (
        click.option(
            "--track",
            type=float,
            metavar="M",
            help="Distance between the wheels, for effects of single wheels. [default: the model's]",
        ),
        click.option(
            "--model", type=click.Path(dir_okay=False, path_type=Path), help="Motion model, as `fit` writes it."
        ),
        click.option(
            "--effect",
            "effects",
            multiple=True,
            metavar="NAME:KEY=VALUE,...",
            shell_complete=_complete_effects,
            help="Systematic error (repeatable).",
        ),
        click.option(
            "--preset",
            metavar="NAME",
            shell_complete=_complete_presets,
            help="Ready-made numbers: typical, article, optitrack-diff-drive, optitrack-tricycle, mrclam-create. "
            "[default: typical]",
        ),
        click.option(
            "--step",
            metavar="STEP",
            help="Apply a book law once per distance or angle, as in 0.25m,0.2rad. [default: message]",
        ),
        click.option(
            "--twist-noise", nargs=2, type=float, metavar="V W", help="White noise on every twist, m/s and rad/s."
        ),
        click.option(
            "--law",
            metavar="NAME",
            shell_complete=_complete_laws,
            help="What A1... mean: diffusion, linear, quadratic, velocity, omni, article-code. [default: diffusion]",
        ),
        click.option(
            "--alpha",
            metavar="A1 A2 A3 A4",
            help="Noise: as 0.05, 5deg (after 1 rad), 10deg/m (after 1 m). [omni: 4 or 5, velocity: 4 to 6]",
        ),
    ):
        command = option(command)
    return command


class AlphaCommand(click.Command):
    """A command whose --alpha takes as many numbers as follow it: laws differ in how many they have."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Join the numbers behind --alpha into one value."""
        joined: list[str] = []
        rest = list(args)
        while rest:
            joined.append(rest.pop(0))
            if joined[-1] == "--":
                break
            if joined[-1] == "--alpha":
                count = next((i for i, word in enumerate(rest[:MOST]) if not NUMBER.match(word)), min(len(rest), MOST))
                # fewer than four are taken as four, so that what is not a number can be named
                count = max(count, min(4, len(rest))) if not rest or "," not in rest[0] else 1
                joined.append(" ".join(rest[:count]))
                del rest[:count]
        return super().parse_args(ctx, joined + rest)


def choose_model(
    *,
    alpha: str | None = None,
    law: str | None = None,
    twist_noise: tuple[float, float] | None = None,
    step: str | None = None,
    preset: str | None = None,
    effects: tuple[str, ...] = (),
    model: Path | None = None,
    track: float | None = None,
) -> Model:
    """Return the model that the options describe; with no numbers at all, the default preset.

    Raises
    ------
    click.UsageError
        Where options contradict each other or one of them makes no sense.
    ModelError
        Where the model file is wrong.

    """
    from odomcorrupt.api.model import Model
    from odomcorrupt.errors import ModelError

    alpha, preset, model = _typed_before_defaults(alpha, preset, model)
    given = [name for name, value in (("--alpha", alpha), ("--preset", preset), ("--model", model)) if value]
    if len(given) > 1 and given != ["--alpha", "--model"]:
        raise click.UsageError(f"{' and '.join(given)} both bring noise; give one of them")
    if law is not None and alpha is None:
        raise click.UsageError(f"--law {law}: what coefficients mean depends on the law, so give them with --alpha")
    if track is not None and not 0.0 < track < 100.0:
        raise click.UsageError(f"--track {track:g}: it must be metres between the wheels, more than zero")
    base = None if model is None else Model.load(model)
    try:
        chosen = _noise(alpha, law, preset, base, others=bool(effects or twist_noise))
        chosen = _refined(chosen, step, twist_noise)
        if track is not None:
            chosen = Model.of(replace(chosen.motion_model, track_m=track), chosen.origin)
        return chosen.with_effects(effects)
    except ModelError as error:
        said = str(error)
        raise click.UsageError(f"--{said}" if said.startswith("effect ") else said) from error


def _typed_before_defaults(
    alpha: str | None, preset: str | None, model: Path | None
) -> tuple[str | None, str | None, Path | None]:
    """Return what brings noise: what was typed, where a file of defaults has something else."""
    context = click.get_current_context(silent=True)
    if context is None:
        return alpha, preset, model
    typed = {n for n in ("alpha", "preset", "model") if context.get_parameter_source(n) is ParameterSource.COMMANDLINE}
    if not typed:
        return alpha, preset, model
    return (
        alpha if "alpha" in typed else None,
        preset if "preset" in typed else None,
        model if "model" in typed else None,
    )


def _noise(alpha: str | None, law: str | None, preset: str | None, base: Model | None, *, others: bool) -> Model:
    """Return a model with the noise; none where only other errors are asked for."""
    from odomcorrupt.api.model import Model, Noise

    if alpha is not None:
        _require_spaces(alpha)
        own = law or (base.motion_model.noise.law_name if base is not None else "diffusion")
        noise = Noise(alpha=alpha.split(), law=own).as_motion_noise()
        return _with_noise(base or Model(), noise)
    if base is not None:
        return base
    return Model() if preset is None and others else Model.preset(preset or "typical")


def _with_noise(model: Model, noise: motion_model.Noise) -> Model:
    from odomcorrupt.api.model import Model

    return Model.of(replace(model.motion_model, noise=noise))


def _require_spaces(alpha: str) -> None:
    """Raise where the numbers of --alpha have commas between them."""
    if "," in alpha:
        words = [word for word in re.split(r"[\s,]+", alpha) if word]
        if all(NUMBER.match(word) for word in words):
            raise click.UsageError(f"--alpha {alpha}: put spaces between the numbers: --alpha {' '.join(words)}")


def _refined(model: Model, step: str | None, twist_noise: tuple[float, float] | None) -> Model:
    from odomcorrupt.api.model import Model
    from odomcorrupt.model.motion_model import Step

    noise = model.motion_model.noise
    if twist_noise is not None:
        white_v, white_omega = twist_noise
        noise = replace(noise, coefficients=replace(noise.coefficients, white_v=white_v, white_omega=white_omega))
    if step is not None:
        noise = replace(noise, step=Step.parse(step))
    return Model.of(replace(model.motion_model, noise=noise), model.origin)

"""Options that say which motion model to use: coefficients, presets, effects, files, seeds."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

if TYPE_CHECKING:
    from collections.abc import Callable

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.model.motion_model import MotionModel, Noise
    from odomcorrupt.model.noise_laws import Law

__all__ = ["MODEL_OPTIONS", "AlphaCommand", "Chosen", "choose_model", "model_options"]

MODEL_OPTIONS = ("alpha", "law", "twist_noise", "step", "preset", "effects", "model", "track")
"""What `choose_model` takes."""

MOST = 6
"""The most coefficients that any law has."""

NUMBER = re.compile(r"-?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?(deg|rad)?(/(m|rad))?\Z")


@dataclass(frozen=True, slots=True)
class Chosen:
    """A model, and in words where its numbers come from (empty where the user typed them)."""

    model: MotionModel
    origin: str


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
            help="What A1... mean: diffusion, linear, quadratic, velocity, omni. [default: diffusion]",
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
                count = max(count, min(4, len(rest)))
                joined.append(" ".join(rest[:count]))
                del rest[:count]
        return super().parse_args(ctx, joined + rest)


def choose_model(
    *,
    alpha: str | None,
    law: str | None,
    twist_noise: tuple[float, float] | None,
    step: str | None,
    preset: str | None,
    effects: tuple[str, ...],
    model: Path | None,
    track: float | None = None,
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
    from odomcorrupt.model.model_file import read_model

    given = [name for name, value in (("--alpha", alpha), ("--preset", preset), ("--model", model)) if value]
    if len(given) > 1 and given != ["--alpha", "--model"]:
        raise click.UsageError(f"{' and '.join(given)} both bring noise; give one of them")
    if law is not None and alpha is None:
        raise click.UsageError(f"--law {law}: what coefficients mean depends on the law, so give them with --alpha")
    if track is not None and not 0.0 < track < 100.0:
        raise click.UsageError(f"--track {track:g}: it must be metres between the wheels, more than zero")
    base = None if model is None else read_model(model)
    try:
        added = tuple(_effect(text) for text in effects)
        noise, origin = _noise(alpha, law, preset, base, others=bool(added or twist_noise))
        if base is not None and alpha is None:
            origin = f"of {model}"
        noise = _refined(noise, step, twist_noise)
    except ModelError as error:
        raise click.UsageError(str(error)) from error
    start = _model_of(noise) if base is None else replace(base, noise=noise)
    start = start if track is None else replace(start, track_m=track)
    return Chosen(replace(start, effects=start.effects + added), origin)


def _noise(
    alpha: str | None, law: str | None, preset: str | None, base: MotionModel | None, *, others: bool
) -> tuple[Noise, str]:
    """Return the noise, and where it comes from; none where only other errors are asked for."""
    from odomcorrupt.model.motion_model import Noise
    from odomcorrupt.model.noise_laws import Coefficients, law_named
    from odomcorrupt.model.presets import DEFAULT, preset_named

    if alpha is not None:
        chosen_law = law_named(law or (base.noise.law_name if base is not None else "diffusion"))
        words = alpha.split()
        names = chosen_law.alphas + ("",) * len(words)
        values = [_coefficient(word, name, chosen_law) for word, name in zip(words, names, strict=False)]
        return Noise(chosen_law.name, chosen_law.coefficients(values)), ""
    if base is not None:
        return base.noise, ""
    if preset is None and others:
        return Noise("diffusion", Coefficients(0.0, 0.0, 0.0, 0.0)), ""
    chosen = preset_named(preset or DEFAULT)
    return chosen.noise, f"preset {chosen.name}: {chosen.source}"


def _coefficient(word: str, name: str, law: Law) -> float:
    """Return a coefficient; angles are taken where an angle is meant, and after what it is meant."""
    from odomcorrupt.errors import ModelError
    from odomcorrupt.model.motion_model import parse_alpha

    value = parse_alpha(word)
    unit = next((unit for unit in ("deg", "rad") if unit in word.split("/", maxsplit=1)[0]), None)
    after = word.partition("/")[2]
    cause = "m" if name.endswith("_trans") else "rad"
    if unit is not None and law.degree == 1:
        raise ModelError(f"{name}: {word}; alphas of the law {law.name} scale variances, write them without a unit")
    if unit is not None and name and not name.startswith("rot_"):
        raise ModelError(f"{name}: {word} is an angle, and it is metres; write a number")
    if after and name and after != cause:
        raise ModelError(f"{name}: {word}; it is caused per {cause}, and not per {after}")
    return value


def _refined(noise: Noise, step: str | None, twist_noise: tuple[float, float] | None) -> Noise:
    from odomcorrupt.model.motion_model import Step

    if twist_noise is not None:
        white_v, white_omega = twist_noise
        coefficients = replace(noise.coefficients, white_v=white_v, white_omega=white_omega)
        noise = replace(noise, coefficients=coefficients)
    return noise if step is None else replace(noise, step=Step.parse(step))


def _model_of(noise: Noise) -> MotionModel:
    from odomcorrupt.model.motion_model import MotionModel

    return MotionModel(noise)


def _effect(text: str) -> Effect:
    """Return the effect written as NAME:key=value,key=value; values may be degrees, and NAME module.Class."""
    from odomcorrupt.effects import effect_at, effect_named, effect_of
    from odomcorrupt.effects.effect import choices
    from odomcorrupt.errors import EffectError, ModelError
    from odomcorrupt.model.motion_model import parse_alpha

    name, _, rest = text.partition(":")
    name = name.strip()
    kind = effect_at(name) if "." in name else effect_named(name)
    words = choices(kind)
    values: dict[str, float | str] = {}
    for part in rest.split(",") if rest else ():
        key, equals, value = part.partition("=")
        try:
            values[key.strip()] = value.strip() if key.strip() in words else parse_alpha(value)
        except ModelError:
            equals = ""
        if not equals:
            raise EffectError(f"--effect {text}: {part!r} is not key=number; write as in wheel_scale:e=0.01")
    return effect_of(kind, values)

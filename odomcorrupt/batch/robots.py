"""Plausible copies of one robot: parameters that are distributions, drawn once per run."""

from __future__ import annotations

import tomllib
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from odomcorrupt.effects.effect import check_bounds, parameters
from odomcorrupt.errors import EffectError, ModelError
from odomcorrupt.modelfile import format_model, parse_model
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Container
    from pathlib import Path

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.model import MotionModel

__all__ = ["Spread", "draw_robot", "drawn_values", "spreads_of", "stated_spreads"]

TRIES = 1000
"""How often a value beyond its bounds is drawn anew: what is drawn is a normal cut off there."""


@dataclass(frozen=True, slots=True)
class Spread:
    """A parameter that is a distribution: of an effect, counted from 0, or of the noise (None)."""

    effect: int | None
    parameter: str
    deviation: float


def spreads_of(model: MotionModel, only: Container[str] | None) -> tuple[Spread, ...]:
    """Return what is drawn: all parameters with a standard error, or those of them that are named in `only`.

    Names are those of `standard_errors`: "rot_trans", "wheel_scale.e".
    """

    def deviation(name: str) -> float:
        return model.standard_errors.get(name, 0.0) if only is None or name in only else 0.0

    noise = [Spread(None, f.name, deviation(f.name)) for f in fields(model.noise.coefficients)]
    effects = [
        Spread(number, p.name, deviation(f"{effect.name}.{p.name}"))
        for number, effect in enumerate(model.effects)
        for p in parameters(effect)
    ]
    return tuple(spread for spread in noise + effects if spread.deviation > 0.0)


def stated_spreads(path: Path) -> frozenset[str]:
    """Return the parameters that a model file gives as "0.004 +- 0.001": a person meant them as distributions.

    A fit's own standard errors are written apart, and drawn on demand only.
    """
    table = tomllib.loads(path.read_text(encoding="utf8"))
    stated = {name for name, value in table.get("noise", {}).items() if _is_spread(value)}
    for item in table.get("effect", []):
        stated |= {f"{item.get('name')}.{name}" for name, value in item.items() if _is_spread(value)}
    return frozenset(stated)


def _is_spread(value: Any) -> bool:
    return isinstance(value, str) and ("+-" in value or "±" in value)


def draw_robot(model: MotionModel, spreads: tuple[Spread, ...], seed: int, run: int) -> MotionModel:
    """Return the robot of a run: the model with drawn parameters, rounded as its file will have them.

    Every parameter has a stream of its own, so one more distribution changes no other value. A robot is certain of
    itself: it carries no standard errors.
    """
    noise, effects = model.noise, list(model.effects)
    for spread in spreads:
        if spread.effect is None:
            value = _draw_coefficient(getattr(noise.coefficients, spread.parameter), spread, seed, run)
            noise = replace(noise, coefficients=replace(noise.coefficients, **{spread.parameter: value}))
        else:
            effects[spread.effect] = _draw_effect(effects[spread.effect], spread, seed, run)
    robot = replace(model, noise=noise, effects=tuple(effects), standard_errors={})
    # one number of the file has nine digits: the run alone, made from its file, must have the same bytes
    return parse_model(format_model(robot))


def drawn_values(robot: MotionModel, spreads: tuple[Spread, ...]) -> dict[str, float]:
    """Return the values of a robot that were drawn, by the names of `standard_errors`."""
    values = {}
    for spread in spreads:
        if spread.effect is None:
            values[spread.parameter] = float(getattr(robot.noise.coefficients, spread.parameter))
        else:
            effect = robot.effects[spread.effect]
            values[f"{effect.name}.{spread.parameter}"] = float(getattr(effect, spread.parameter))
    return values


def _draw_coefficient(mean: float, spread: Spread, seed: int, run: int) -> float:
    rng = stream(seed, run, f"robot {spread.parameter}")
    for _ in range(TRIES):
        value = mean + spread.deviation * float(rng.standard_normal())
        if value >= 0.0:
            return value
    raise ModelError(f"{spread.parameter}: {mean:g} +- {spread.deviation:g} is hardly ever above 0; give another mean")


def _draw_effect(effect: Effect, spread: Spread, seed: int, run: int) -> Effect:
    mean = getattr(effect, spread.parameter)
    rng = stream(seed, run, f"robot {effect.name}.{spread.parameter}", spread.effect or 0)
    for _ in range(TRIES):
        value = mean + spread.deviation * float(rng.standard_normal())
        drawn: Effect = replace(effect, **{spread.parameter: value})  # type: ignore[type-var]  # every effect is a dataclass
        try:
            check_bounds(drawn)
        except EffectError:
            continue
        return drawn
    raise ModelError(
        f"{effect.name}.{spread.parameter}: {mean:g} +- {spread.deviation:g} is hardly ever within its bounds; give "
        "another mean"
    )

"""Plausible copies of one robot: parameters that are distributions, drawn once per run."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from odomcorrupt.effects.effect import check_bounds, parameters
from odomcorrupt.errors import EffectError, ModelError
from odomcorrupt.model.correlation import Correlation
from odomcorrupt.model.model_file import format_model, parse_model
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Container, Sequence
    from pathlib import Path

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.model.motion_model import MotionModel

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
        error = model.standard_errors.get(name, 0.0) if only is None or name in only else 0.0
        if not math.isfinite(error):
            raise ModelError(f"{name}: standard error {error:g}; to draw robots, write how far it may be off")
        return error

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

    Every parameter has a stream of its own, so one more distribution changes no value that it does not hang together
    with. Parameters that the model's correlation ties together are drawn, and where one is beyond its bounds drawn
    again, together. A robot is certain of itself: it carries no standard errors.
    """
    named = {_name(model, spread): spread for spread in spreads}
    known = model.correlation.among(named)
    groups = known.groups()
    tied = {name for group in groups for name in group}
    robot = model
    for names in [*groups, *((name,) for name in named if name not in tied)]:
        factor = known.among(names).factor() if len(names) > 1 else [[1.0]]
        robot = _drawn(robot, [named[name] for name in names], factor, seed, run)
    robot = replace(robot, standard_errors={}, correlation=Correlation())
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


def _name(model: MotionModel, spread: Spread) -> str:
    """Return a parameter's name among the standard errors."""
    return spread.parameter if spread.effect is None else f"{model.effects[spread.effect].name}.{spread.parameter}"


def _mean(model: MotionModel, spread: Spread) -> float:
    owner = model.noise.coefficients if spread.effect is None else model.effects[spread.effect]
    return float(getattr(owner, spread.parameter))


def _drawn(
    model: MotionModel, spreads: Sequence[Spread], factor: Sequence[Sequence[float]], seed: int, run: int
) -> MotionModel:
    """Return a model with parameters drawn whose errors are factor (n, n) times standard normals."""
    names = [_name(model, spread) for spread in spreads]
    streams = [
        stream(seed, run, f"robot {name}", 0 if spread.effect is None else spread.effect)
        for name, spread in zip(names, spreads, strict=True)
    ]
    means = [_mean(model, spread) for spread in spreads]
    for _ in range(TRIES):
        normals = [float(rng.standard_normal()) for rng in streams]
        drawn = model
        for spread, mean, row in zip(spreads, means, factor, strict=True):
            error = math.fsum(weight * normal for weight, normal in zip(row, normals, strict=True))
            changed = _with(drawn, spread, mean + spread.deviation * error)
            if changed is None:
                break
            drawn = changed
        else:
            return drawn
    said = ", ".join(f"{n} {m:g} +- {s.deviation:g}" for n, m, s in zip(names, means, spreads, strict=True))
    raise ModelError(f"{said}: hardly ever within bounds; give another mean or a smaller spread")


def _with(model: MotionModel, spread: Spread, value: float) -> MotionModel | None:
    """Return a model with one parameter changed; None where that is beyond its bounds."""
    if spread.effect is None:
        if not value >= 0.0:
            return None
        coefficients = replace(model.noise.coefficients, **{spread.parameter: value})
        return replace(model, noise=replace(model.noise, coefficients=coefficients))
    effects = list(model.effects)
    effect: Effect = replace(effects[spread.effect], **{spread.parameter: value})  # type: ignore[type-var]  # every effect is a dataclass
    try:
        check_bounds(effect)
    except EffectError:
        return None
    effects[spread.effect] = effect
    return replace(model, effects=tuple(effects))

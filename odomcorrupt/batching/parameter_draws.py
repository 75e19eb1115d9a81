"""Model parameters drawn once per run from their distributions."""

from __future__ import annotations

import math
import tomllib
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from odomcorrupt.effects.effect import check_bounds, parameters
from odomcorrupt.errors import EffectError, ModelError
from odomcorrupt.model.correlation import Correlation
from odomcorrupt.model.model_file import format_model, parse_model, read_model_text
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Container, Sequence
    from pathlib import Path

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["Spread", "draw_robot", "drawn_values", "spreads_of", "stated_spreads"]

TRIES = 1000
"""Maximum number of draws until a value is within its bounds: the distribution is a truncated normal."""


@dataclass(frozen=True, slots=True)
class Spread:
    """Standard deviation of a drawn parameter, of an effect (index from 0) or of the noise (None)."""

    effect: int | None
    parameter: str
    deviation: float


def spreads_of(model: MotionModel, only: Container[str] | None) -> tuple[Spread, ...]:
    """Return the distributions of all parameters with a standard error, or of those of them named in `only`.

    Names are the keys of `standard_errors`, such as "rot_trans" and "wheel_scale.e".
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
    """Return the names of the parameters written as "0.004 +- 0.001" in a model file.

    The standard errors of a fit are stored elsewhere in the file, and drawn only on request.
    """
    table = tomllib.loads(read_model_text(path))
    stated = {name for name, value in table.get("noise", {}).items() if _is_spread(value)}
    for item in table.get("effect", []):
        stated |= {f"{item.get('name')}.{name}" for name, value in item.items() if _is_spread(value)}
    return frozenset(stated)


def _is_spread(value: Any) -> bool:
    return isinstance(value, str) and ("+-" in value or "±" in value)


def draw_robot(model: MotionModel, spreads: tuple[Spread, ...], seed: int, run: int) -> MotionModel:
    """Return the model of a run: drawn parameters, rounded to the precision of its file, and no standard errors.

    Every parameter has a random stream of its own, so a further distribution changes no parameter that it is not
    correlated with. Correlated parameters are drawn jointly; where one is out of bounds, all of them are drawn again.
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
    # the file has nine digits: a single run made from it must have the same bytes
    return parse_model(format_model(robot))


def drawn_values(robot: MotionModel, spreads: tuple[Spread, ...]) -> dict[str, float]:
    """Return the drawn parameters of a model, by the keys of `standard_errors`."""
    values = {}
    for spread in spreads:
        if spread.effect is None:
            values[spread.parameter] = float(getattr(robot.noise.coefficients, spread.parameter))
        else:
            effect = robot.effects[spread.effect]
            values[f"{effect.name}.{spread.parameter}"] = float(getattr(effect, spread.parameter))
    return values


def _name(model: MotionModel, spread: Spread) -> str:
    """Return a parameter's key in `standard_errors`."""
    return spread.parameter if spread.effect is None else f"{model.effects[spread.effect].name}.{spread.parameter}"


def _mean(model: MotionModel, spread: Spread) -> float:
    owner = model.noise.coefficients if spread.effect is None else model.effects[spread.effect]
    return float(getattr(owner, spread.parameter))


def _drawn(
    model: MotionModel, spreads: Sequence[Spread], factor: Sequence[Sequence[float]], seed: int, run: int
) -> MotionModel:
    """Return a model with parameters drawn from a normal distribution with Cholesky factor (n, n)."""
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
    """Return a model with one parameter changed; None where the value is out of bounds."""
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

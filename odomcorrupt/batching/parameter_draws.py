"""Model parameters drawn once per run from their distributions, and the distribution of a fleet of robots."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import TYPE_CHECKING, Any

from odomcorrupt.effects.effect import check_bounds, choices, parameters
from odomcorrupt.errors import EffectError, ModelError
from odomcorrupt.input_files import parse_toml
from odomcorrupt.model.correlation import Correlation
from odomcorrupt.model.model_file import format_model, parse_model, read_model_text
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Container, Mapping, Sequence
    from pathlib import Path

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.model.motion_model import MotionModel

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
            raise ModelError(f"{name}: standard error {error:g}; to draw robots, give a finite one")
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
    table = parse_toml(read_model_text(path))
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

    model : means, and correlations of their errors
    spreads : standard deviations of the parameters to draw
    seed, run : seed of all draws, and number of the run
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


def _drawn(
    model: MotionModel, spreads: Sequence[Spread], factor: Sequence[Sequence[float]], seed: int, run: int
) -> MotionModel:
    """Return a model with parameters drawn from a normal distribution with Cholesky factor (n, n)."""
    names = [_name(model, spread) for spread in spreads]
    streams = [
        stream(seed, run, f"robot {name}", 0 if spread.effect is None else spread.effect)
        for name, spread in zip(names, spreads, strict=True)
    ]
    owners = [model.noise.coefficients if spread.effect is None else model.effects[spread.effect] for spread in spreads]
    means = [float(getattr(owner, spread.parameter)) for owner, spread in zip(owners, spreads, strict=True)]
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
    raise ModelError(f"{said}: draws are hardly ever within bounds; give another mean or a smaller spread")


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


def fleet_model(robots: Mapping[str, MotionModel]) -> MotionModel:
    """Return a model with the mean parameters of the robots, and their between-robot deviation as standard errors.

    The variance between robots is the sample variance less the mean squared standard error of the fits, at least 0
    (the moment estimator of a random-effects model: DerSimonian & Laird, Controlled Clinical Trials 7(3), 1986).
    Parameters are treated as independent: a handful of robots does not determine their correlation. A robot without
    an effect counts with the effect's identity value; shapes, such as time constants, are averaged over the robots
    that have the effect.

    robots : models by file name, two or more

    Raises
    ------
    ModelError
        If there are fewer than two, or their noise laws, steps or an effect's options differ.
    """
    if len(robots) < 2:
        raise ModelError(f"a fleet: {len(robots)} robots; a spread between robots takes two or more model files")
    models = list(robots.values())
    _require_same([(name, f"{m.noise.law_name}, step {m.noise.step}") for name, m in robots.items()], "noise laws")
    errors: dict[str, float] = {}
    coefficients = {}
    for field in fields(models[0].noise.coefficients):
        values = [getattr(m.noise.coefficients, field.name) for m in models]
        coefficients[field.name], errors[field.name] = _spread(values, [m.standard_errors for m in models], field.name)
    effects = [_effect(name, robots, errors) for name in _effect_names(models)]
    tracks = [m.track_m for m in models if m.track_m is not None]
    known = {name: error for name, error in errors.items() if error > 0.0}
    noise = replace(models[0].noise, coefficients=replace(models[0].noise.coefficients, **coefficients))
    fleet = replace(
        models[0], noise=noise, effects=tuple(effects), track_m=sum(tracks) / len(tracks) if tracks else None,
        standard_errors=known, correlation=Correlation(), source={"fleet": ", ".join(robots)},
        setup=type(models[0].setup)(),
    )  # fmt: skip
    return parse_model(format_model(fleet))


def _require_same(facts: Sequence[tuple[str, str]], what: str) -> None:
    if len({fact for _, fact in facts}) > 1:
        facts_text = "; ".join(f"{name}: {fact}" for name, fact in facts)
        raise ModelError(f"a fleet: its robots have different {what} ({facts_text}); fit them with the same")


def _effect_names(models: Sequence[MotionModel]) -> list[str]:
    for model in models:
        own = [effect.name for effect in model.effects]
        if len(set(own)) < len(own):
            twice = next(name for name in own if own.count(name) > 1)
            raise ModelError(f"a fleet: a robot has {twice} twice; the two cannot be matched between robots")
    return list(dict.fromkeys(effect.name for model in models for effect in model.effects))


def _effect(name: str, robots: Mapping[str, MotionModel], errors: dict[str, float]) -> Effect:
    """Return an effect at the mean of the robots; the deviations between robots are added to `errors`."""
    own = {robot: e for robot, model in robots.items() for e in model.effects if e.name == name}
    have = list(own.values())
    _require_same(
        [(robot, str({w: getattr(e, w) for w in choices(e)})) for robot, e in own.items()], f"words of {name}"
    )
    if len({type(e) for e in have}) > 1:
        raise ModelError(f"a fleet: {name} is not the same expression in {', '.join(own)}; rename one")
    values = {}
    for p in parameters(have[0]):
        members = [(getattr(e, p.name), robots[robot].standard_errors) for robot, e in own.items()]
        if p.amplitude:
            members += [(p.identity, {})] * (len(robots) - len(have))
        key = f"{name}.{p.name}"
        if len(members) < 2:
            values[p.name] = members[0][0]
            continue
        values[p.name], errors[key] = _spread([m[0] for m in members], [m[1] for m in members], key)
    return replace(have[0], **values)  # type: ignore[type-var]  # every effect is a dataclass


def _spread(values: Sequence[float], errors: Sequence[Mapping[str, float]], name: str) -> tuple[float, float]:
    """Return a parameter's mean and its standard deviation between robots."""
    n = len(values)
    mean = math.fsum(values) / n
    sample = math.fsum((value - mean) ** 2 for value in values) / (n - 1)
    fits = math.fsum(one.get(name, 0.0) ** 2 for one in errors) / n
    return mean, math.sqrt(max(sample - fits, 0.0))

"""A fleet: the parameter distribution of several learned robots, from which further robots are drawn."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import TYPE_CHECKING

from odomcorrupt.effects.effect import choices, parameters
from odomcorrupt.errors import ModelError
from odomcorrupt.model.correlation import Correlation
from odomcorrupt.model.model_file import format_model, parse_model

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["fleet_model"]


def fleet_model(robots: Mapping[str, MotionModel]) -> MotionModel:
    """Return a model with the mean parameters of the robots, and their between-robot deviation as standard errors.

    The variance between robots is the sample variance less the mean squared standard error of the fits, at least 0
    (the moment estimator of a random-effects model: DerSimonian & Laird, Controlled Clinical Trials 7(3), 1986).
    Parameters are treated as independent: a handful of robots does not determine their correlation. A robot without
    an effect counts with the effect's identity value; shapes, such as time constants, are averaged over the robots
    that have the effect.

    Parameters
    ----------
    robots
        Models by file name, two or more.

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
        told = "; ".join(f"{name}: {fact}" for name, fact in facts)
        raise ModelError(f"a fleet: its robots have different {what} ({told}); fit them with the same")


def _effect_names(models: Sequence[MotionModel]) -> list[str]:
    for model in models:
        own = [effect.name for effect in model.effects]
        if len(set(own)) < len(own):
            twice = next(name for name in own if own.count(name) > 1)
            raise ModelError(f"a fleet: a robot has {twice} twice; which of them is which is not known")
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
    effect: Effect = replace(have[0], **values)  # type: ignore[type-var]  # every effect is a dataclass
    return effect


def _spread(values: Sequence[float], errors: Sequence[Mapping[str, float]], name: str) -> tuple[float, float]:
    """Return a parameter's mean and its standard deviation between robots."""
    n = len(values)
    mean = math.fsum(values) / n
    sample = math.fsum((value - mean) ** 2 for value in values) / (n - 1)
    fits = math.fsum(one.get(name, 0.0) ** 2 for one in errors) / n
    return mean, math.sqrt(max(sample - fits, 0.0))

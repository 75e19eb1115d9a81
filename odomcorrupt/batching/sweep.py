"""Sweeps: a batch for each of several models, at listed parameter values or at Sobol points of ranges."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, fields, replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING, Any

from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.effects.effect import check_bounds, parameters
from odomcorrupt.errors import ModelError
from odomcorrupt.extras import require
from odomcorrupt.model.model_file import format_model, parse_model, read_model
from odomcorrupt.model.motion_model import parse_alpha

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.model.motion_model import MotionModel

_MOST_POINTS = 1 << 14


@dataclass(frozen=True, slots=True)
class Range:
    """Range of a parameter; `log`: with even coverage of its logarithm."""

    name: str
    low: float
    high: float
    log: bool

    def at(self, part: float) -> str:
        """Return the value at a fraction of the range, 0 to 1, with four digits."""
        if self.log:
            return f"{self.low * (self.high / self.low) ** part:.4g}"
        return f"{self.low + part * (self.high - self.low):.4g}"


def parse_range(text: str) -> Range | None:
    """Return a range written as "alpha-scale=0.25..4:log" or "wheel_scale.e=-0.02..0.02"; None where it is a list.

    Raises
    ------
    ModelError
        If its ends are not finite, not ascending, or not positive for `log`.
    """
    match = re.fullmatch(r"\s*([^=]+?)\s*=\s*([^,]+?)\.\.([^,:]+?)(:log)?\s*", text)
    if match is None:
        return None
    low, high, log = parse_alpha(match[2]), parse_alpha(match[3]), match[4] is not None
    if not (math.isfinite(low) and math.isfinite(high) and low < high) or (log and not low > 0.0):
        raise ModelError(f"--sweep {text}: a range goes from the lower value to the higher one, above 0 with :log")
    return Range(match[1], low, high, log)


def sobol_points(ranges: Sequence[Range], count: int) -> list[list[tuple[str, str]]]:
    """Return names and values of `count` points that cover the product of all ranges evenly.

    The points are the first ones of a Sobol sequence, without scrambling and each in the middle of its cell: the same
    for every seed and machine. Powers of two cover best.
    Source: Sobol, USSR Comput. Math. Math. Phys. 7(4), 1967; Joe & Kuo, SIAM J. Sci. Comput. 30, 2008.

    Raises
    ------
    ModelError
        If the count is out of bounds.
    """
    if not 1 <= count <= _MOST_POINTS:
        raise ModelError(f"--points {count}: must be 1 to {_MOST_POINTS}")
    require("scipy", "ranges of a sweep need it")
    from scipy.stats import qmc  # noqa: PLC0415 - slow to import, and an extra

    exponent = max(math.ceil(math.log2(count)), 0)
    parts: Any = qmc.Sobol(len(ranges), scramble=False).random_base2(exponent)[:count] + 0.5 / 2**exponent
    return [[(one.name, one.at(float(part))) for one, part in zip(ranges, row, strict=True)] for row in parts]


@dataclass(frozen=True, slots=True)
class Variant:
    """A model of a sweep, and the directory of its runs, "" without a sweep."""

    name: str
    model: MotionModel


def variants(model: MotionModel, sweeps: Sequence[str], points: int = 0) -> list[Variant]:
    """Return the models of all combinations of sweeps, each NAME=VALUE,VALUE or a range NAME=LOW..HIGH.

    NAME is alpha-scale (factor on all noise), model (files), a coefficient, or EFFECT.PARAMETER; an effect that the
    model lacks is added. The product of all ranges is sampled at `points` points of a Sobol sequence.

    Raises
    ------
    ModelError
        If a name is unknown, or a value is invalid.
    """
    axes = []
    ranges = [one for text in sweeps if (one := parse_range(text)) is not None]
    if bool(ranges) != bool(points):
        raise ModelError("--sweep NAME=LOW..HIGH and --points N go together; give both or neither")
    for text in sweeps:
        if parse_range(text) is not None:
            continue
        name, equals, rest = text.partition("=")
        values = [value.strip() for value in rest.split(",")]
        if not equals or not all(values) or len(set(values)) < len(values):
            raise ModelError(f"--sweep {text}: write a name and different values, as in alpha-scale=0.5,1,2")
        axes.append([(name.strip(), value) for value in values])
    # models first: the other sweeps change them
    axes.sort(key=lambda axis: axis[0][0] != "model")
    found = []
    covered = sobol_points(ranges, points) if ranges else [[]]
    for point in ((*one, *more) for one in product(*axes) for more in covered):
        chosen = model
        for name, value in point:
            chosen = _changed(chosen, name, value)
        label = ",".join(f"{name}={Path(value).stem if name == 'model' else value}" for name, value in point)
        found.append(Variant(label.replace("/", "_"), parse_model(format_model(chosen)) if point else chosen))
    names = [one.name for one in found]
    if len(set(names)) < len(names):
        raise ModelError(f"--sweep: two of {', '.join(names)} have the same name; give the files different ones")
    return found


def _changed(model: MotionModel, name: str, value: str) -> MotionModel:
    if name == "model":
        return read_model(Path(value))
    number = parse_alpha(value)
    k = model.noise.coefficients
    known = [field.name for field in fields(k)]
    if name == "alpha-scale":
        if number < 0.0:
            raise ModelError(f"--sweep alpha-scale: {value}; it must not be below 0")
        # coefficients that scale a variance grow fourfold to double the noise
        squared = model.noise.law.alphas if model.noise.law.degree == 1 else ()
        factors = {one: number**2 if one in squared else number for one in known}
        errors = {key: error * factors.get(key, 1.0) for key, error in model.standard_errors.items()}
        scaled = replace(k, **{one: getattr(k, one) * factors[one] for one in known})
        return replace(model, noise=replace(model.noise, coefficients=scaled), standard_errors=errors)
    if name in known:
        return replace(model, noise=replace(model.noise, coefficients=replace(k, **{name: number})))
    effect, _, parameter = name.partition(".")
    effects = list(model.effects)
    for i, one in enumerate(effects):
        if one.name == effect and parameter in {p.name for p in parameters(one)}:
            effects[i] = replace(one, **{parameter: number})  # type: ignore[type-var]  # every effect is a dataclass
            check_bounds(effects[i])
            return replace(model, effects=tuple(effects))
    if parameter and effect in registry() and parameter in {p.name for p in parameters(registry()[effect])}:
        return replace(model, effects=(*effects, effect_from_values(effect, {parameter: number})))
    own = [f"{one.name}.{p.name}" for one in effects for p in parameters(one)]
    raise ModelError(f"--sweep {name}: is not known; there are alpha-scale, model, {', '.join([*known, *own])}")

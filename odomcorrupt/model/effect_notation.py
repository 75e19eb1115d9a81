"""Parsing of effects in command-line notation: "wheelbase:e=1%", "slip_burst", "my_file.Wobble:size=0.1"."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.effects import effect_at, effect_named, effect_of
from odomcorrupt.effects.effect import amplitudes, choices, parameters
from odomcorrupt.errors import EffectError, ModelError
from odomcorrupt.model.motion_model import parse_alpha

if TYPE_CHECKING:
    from odomcorrupt.effects.effect import Effect

_PERCENT = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*%\s*\Z")


class WrittenEffect(NamedTuple):
    """A parsed effect, with the values that were assumed for parameters not given.

    assumed : typical sizes that were used, as in "curvature 0.005 1/m"; "" if sizes were given
    """

    effect: Effect
    assumed: str


def parse_effect(text: str) -> WrittenEffect:
    """Return the effect written as NAME or NAME:key=value,key=value; NAME is in the library or is module.Class.

    Values are numbers, percentages for parameters without unit (1%), or angles (5deg). If no amplitude is given, the
    typical one is used.

    Raises
    ------
    EffectError
        If the name or a parameter is unknown, or a value is invalid.
    """
    name, _, rest = text.partition(":")
    name = name.strip()
    if "=" in name:
        known, _, value = name.partition("=")
        key = parameters(effect_named(known))[0].name
        raise EffectError(f"effect {text}: parameters follow a colon and a name; write {known}:{key}={value}")
    kind = effect_at(name) if "." in name else effect_named(name)
    words = choices(kind)
    units = {p.name: p.unit for p in parameters(kind)}
    values: dict[str, float | str] = {}
    for part in rest.split(",") if rest else ():
        key, equals, value = (piece.strip() for piece in part.partition("="))
        if not equals:
            raise EffectError(f"effect {text}: {part!r} is not key=number; write as in wheel_scale:e=0.01")
        values[key] = value if key in words else _number(text, part, value, units.get(key, ""))
    typical = {p.name: p.typical for p in amplitudes(kind)}
    if typical.keys().isdisjoint(values):
        assumed = ", ".join(f"{p.name} {p.typical:g} {p.unit}".strip() for p in amplitudes(kind))
        return WrittenEffect(effect_of(kind, {**typical, **values}), assumed)
    return WrittenEffect(effect_of(kind, values), "")


def _number(text: str, part: str, value: str, unit: str) -> float:
    percent = _PERCENT.match(value)
    if percent is not None:
        if unit:
            raise EffectError(
                f"effect {text}: {part!r} is a share, but the parameter has the unit {unit}; write a number"
            )
        return float(percent[1]) / 100.0
    try:
        return parse_alpha(value)
    except ModelError:
        raise EffectError(f"effect {text}: {part!r} is not key=number; write as in wheel_scale:e=0.01") from None

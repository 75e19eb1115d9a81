"""The library of effects: one file each; a new file is found without touching any other."""

from __future__ import annotations

import difflib
import importlib
import pkgutil
from functools import cache
from types import MappingProxyType
from typing import TYPE_CHECKING

from odomcorrupt.effects.effect import Effect, check_bounds, parameters
from odomcorrupt.errors import EffectError

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["Effect", "effect_from_values", "registry"]


@cache
def registry() -> Mapping[str, type[Effect]]:
    """Return every effect class by name, in the order of their names."""
    found: dict[str, type[Effect]] = {}
    for info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{info.name}")
        for value in vars(module).values():
            if isinstance(value, type) and issubclass(value, Effect) and "name" in vars(value):
                found[value.name] = value
    return MappingProxyType(dict(sorted(found.items())))


def effect_from_values(name: str, values: Mapping[str, float]) -> Effect:
    """Return an effect by name with parameter values.

    Raises
    ------
    EffectError
        For an unknown effect or parameter (with the nearest name there is) or a value out of bounds.

    """
    known = registry()
    if name not in known:
        raise EffectError(f"no effect is called {name!r}{_nearest(name, known)}; there are {', '.join(known)}")
    names = [p.name for p in parameters(known[name])]
    for key in values:
        if key not in names:
            raise EffectError(
                f"effect {name} has no parameter {key!r}{_nearest(key, names)}; it has {', '.join(names)}"
            )
    effect = known[name](**values)
    check_bounds(effect)
    return effect


def _nearest(word: str, words: object) -> str:
    near = difflib.get_close_matches(word, list(words), 1)  # type: ignore[call-overload]
    return f" (did you mean {near[0]}?)" if near else ""

"""Registry of effects: one module per family, discovered automatically.

Other packages add effects through the entry point group `odomcorrupt.effects`, one class per entry point.
"""

from __future__ import annotations

import importlib.machinery
import importlib.util
import pkgutil
import sys
import warnings
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

from odomcorrupt.effects.effect import Effect, check_bounds, choices, parameters
from odomcorrupt.errors import EffectError

if TYPE_CHECKING:
    from collections.abc import Mapping

__all__ = ["GROUP", "Effect", "effect_at", "effect_from_values", "effect_named", "effect_of", "registry"]
imported_from: dict[str, str] = {}
"""Modules that `import_from` has imported, and their folders; workers of a batch import them again."""
GROUP = "odomcorrupt.effects"
"""Entry point group in which other packages register effect classes."""


@cache
def registry() -> Mapping[str, type[Effect]]:
    """Return all effect classes by name, sorted by name."""
    # slow to import, and corruption by noise alone needs no effect
    from importlib.metadata import entry_points  # noqa: PLC0415

    found: dict[str, type[Effect]] = {}
    for info in pkgutil.iter_modules(__path__):
        module = importlib.import_module(f"{__name__}.{info.name}")
        for value in vars(module).values():
            if isinstance(value, type) and issubclass(value, Effect) and "name" in vars(value):
                found[value.name] = value
    for point in entry_points(group=GROUP):
        try:
            kind = point.load()
        except Exception as error:  # noqa: BLE001 - another package's code may fail in any way, and must not stop ours
            warnings.warn(f"effect {point.name} of {point.value}: cannot be loaded ({error})", stacklevel=2)
            continue
        if not (isinstance(kind, type) and issubclass(kind, Effect)) or kind.name in found:
            warnings.warn(
                f"effect {point.name} of {point.value}: not an effect class, or its name is taken", stacklevel=2
            )
            continue
        found[kind.name] = kind
    return MappingProxyType(dict(sorted(found.items())))


def effect_named(name: str) -> type[Effect]:
    """Return the effect class of a name; the EffectError for an unknown name suggests the closest match."""
    known = registry()
    if name not in known:
        raise EffectError(f"no effect is called {name!r}{_nearest(name, known)}; there are {', '.join(known)}")
    return known[name]


def effect_from_values(name: str, values: Mapping[str, float | str]) -> Effect:
    """Return the effect of a name, with the given parameter values.

    Raises
    ------
    EffectError
        If the effect or a parameter is unknown (with the closest match), or a value is out of bounds.

    """
    return effect_of(effect_named(name), values)


def effect_at(path: str) -> type[Effect]:
    """Return the effect class at "module.Class", of an installed package or else of the working directory.

    Only user input may name code to import; a model or configuration file may not. The working directory is not put on
    Python's path, where it could replace any module that is imported later.

    Raises
    ------
    EffectError
        If there is no such effect class.

    """
    module_name, _, class_name = path.rpartition(".")
    top = module_name.partition(".")[0]
    try:
        if importlib.util.find_spec(top) is None:
            import_from(top, str(Path.cwd()))
        kind = getattr(importlib.import_module(module_name), class_name, None)
    except Exception as error:  # another package's code may raise anything
        raise EffectError(
            f"effect {path}: {module_name} cannot be imported ({type(error).__name__}: {error}); it must be a module "
            "of this folder or of an installed package"
        ) from error
    if not (isinstance(kind, type) and issubclass(kind, Effect) and "name" in vars(kind)):
        raise EffectError(
            f"effect {path}: is not an effect class; name one made as docs/effects.md says, as in my_file.Wobble"
        )
    return kind


def import_from(name: str, folder: str) -> None:
    """Import a module or package of a folder that is not on Python's path; without effect if there is none."""
    spec = importlib.machinery.PathFinder.find_spec(name, [folder])
    if spec is None or spec.loader is None:
        return
    module = sys.modules[name] = importlib.util.module_from_spec(spec)
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise
    imported_from[name] = folder


def effect_of(kind: type[Effect], values: Mapping[str, float | str]) -> Effect:
    """Return an effect of the given class with parameter values; raises EffectError as `effect_from_values` does."""
    name = kind.name
    names = [*(p.name for p in parameters(kind)), *choices(kind)]
    for key in values:
        if key not in names:
            raise EffectError(
                f"effect {name} has no parameter {key!r}{_nearest(key, names)}; it has {', '.join(names)}"
            )
    effect = kind(**values)
    check_bounds(effect)
    return effect


def _nearest(word: str, words: object) -> str:
    import difflib  # noqa: PLC0415 - slow to import, for a message only

    near = difflib.get_close_matches(word, list(words), 1)  # type: ignore[call-overload]
    return f" (did you mean {near[0]}?)" if near else ""

"""Conversion of values to valid JSON, which has no NaN and no infinity, and of objects by the names of their fields."""

from __future__ import annotations

import math
from collections.abc import Mapping
from operator import attrgetter
from typing import Any


def picked(one: object, *names: str, **renamed: str) -> dict[str, Any]:
    """Return attributes of an object by their names, and others, also of attributes as "nats.per_m", by new names."""
    return {name: attrgetter(path)(one) for name, path in (*zip(names, names, strict=True), *renamed.items())}


def finite(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values with plain numbers instead of numpy's, and None instead of unknown or infinite ones."""
    return {key: _finite(own) for key, own in values.items()}


def _finite(value: Any) -> Any:
    if hasattr(value, "tolist"):  # a numpy value; tested without importing numpy, which help pages do not need
        return _finite(value.tolist())
    match value:
        case Mapping():
            return finite(value)
        case list() | tuple():
            return [_finite(own) for own in value]
        case float():
            return value if math.isfinite(value) else None
        case _:
            return value

"""Conversion of values to valid JSON, which has no NaN and no infinity, and of objects by the names of their fields."""

from __future__ import annotations

import math
from collections.abc import Mapping
from operator import attrgetter
from typing import Any


def picked(one: object, *names: str, **renamed: str) -> dict[str, Any]:
    """Return attributes of an object by their names, and others, also of attributes as "nats.per_m", by new names."""
    return {name: attrgetter(path)(one) for name, path in (*zip(names, names, strict=True), *renamed.items())}


def finite(value: Any) -> Any:
    """Return values with plain numbers instead of numpy's, and None instead of unknown or infinite ones."""
    if hasattr(value, "tolist"):  # a numpy value; tested without importing numpy, which help pages do not need
        return finite(value.tolist())
    match value:
        case Mapping():
            return {key: finite(own) for key, own in value.items()}
        case list() | tuple():
            return [finite(own) for own in value]
        case float():
            return value if math.isfinite(value) else None
        case _:
            return value

"""What JSON can hold: no NaN and nothing infinite."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

__all__ = ["finite"]


def finite(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values with plain numbers in place of numpy's, and None in place of what is not known or not finite."""
    return {key: _finite(own) for key, own in values.items()}


def _finite(value: Any) -> Any:
    if hasattr(value, "tolist"):  # numpy's, which a help page does without
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

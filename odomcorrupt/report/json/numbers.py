"""What JSON can hold: no NaN and nothing infinite."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

__all__ = ["finite"]


def finite(value: Any) -> Any:
    """Return a value with plain numbers in place of numpy's, and None in place of what is not known or not finite."""
    if hasattr(value, "tolist"):  # numpy's, which a help page does without
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

"""Sentences on what recovery could not read of a damaged bag."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from odomcorrupt.errors import BagError

__all__ = ["loss_of"]

_ADVICE = re.compile(r"[;,]? *(?:try )?--recover\b.*\Z", re.DOTALL)


def loss_of(error: BagError) -> str:
    """Return an error's message without its advice to use --recover."""
    return _ADVICE.sub("", str(error))

"""What could not be read of a damaged bag, told to somebody who asked for recovery."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from odomcorrupt.errors import BagError

__all__ = ["loss_of"]

_ADVICE = re.compile(r"[;,]? *(?:try )?--recover\b.*\Z", re.DOTALL)


def loss_of(error: BagError) -> str:
    """Return an error's sentence without its way out: recovery is under way."""
    return _ADVICE.sub("", str(error))

"""Even coverage of ranges: Sobol points, the same for everybody."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from odomcorrupt.errors import ModelError
from odomcorrupt.extras import require
from odomcorrupt.model.motion_model import parse_alpha

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["Range", "parse_range", "sobol_points"]

_MOST_POINTS = 1 << 14


@dataclass(frozen=True, slots=True)
class Range:
    """A range of a parameter; `log`: covered evenly in its logarithm."""

    name: str
    low: float
    high: float
    log: bool

    def at(self, part: float) -> str:
        """Return the value at a part of the range, 0 to 1, with four digits."""
        if self.log:
            return f"{self.low * (self.high / self.low) ** part:.4g}"
        return f"{self.low + part * (self.high - self.low):.4g}"


def parse_range(text: str) -> Range | None:
    """Return a range written as "alpha-scale=0.25..4:log" or "wheel_scale.e=-0.02..0.02"; None where it is a list.

    Raises
    ------
    ModelError
        Where its ends make no sense.

    """
    match = re.fullmatch(r"\s*([^=]+?)\s*=\s*([^,]+?)\.\.([^,:]+?)(:log)?\s*", text)
    if match is None:
        return None
    low, high, log = parse_alpha(match[2]), parse_alpha(match[3]), match[4] is not None
    if not (math.isfinite(low) and math.isfinite(high) and low < high) or (log and not low > 0.0):
        raise ModelError(f"--sweep {text}: a range goes from the lower value to the higher one, above 0 with :log")
    return Range(match[1], low, high, log)


def sobol_points(ranges: Sequence[Range], count: int) -> list[list[tuple[str, str]]]:
    """Return names and values of `count` points that cover all ranges together evenly.

    The points are the first ones of a Sobol sequence, without scrambling and each in the middle of its cell: the same
    for every seed and machine. Powers of two cover best.
    Source: Sobol, USSR Comput. Math. Math. Phys. 7(4), 1967; Joe & Kuo, SIAM J. Sci. Comput. 30, 2008.

    Raises
    ------
    ModelError
        Where the count is out of bounds.

    """
    if not 1 <= count <= _MOST_POINTS:
        raise ModelError(f"--points {count}: must be 1 to {_MOST_POINTS}")
    require("scipy", "ranges of a sweep need it", "study")
    from scipy.stats import qmc  # noqa: PLC0415 - slow to import, and an extra

    exponent = max(math.ceil(math.log2(count)), 0)
    parts: Any = qmc.Sobol(len(ranges), scramble=False).random_base2(exponent)[:count] + 0.5 / 2**exponent
    return [[(one.name, one.at(float(part))) for one, part in zip(ranges, row, strict=True)] for row in parts]

"""The top of the hill that a shape stands on: all its numbers move at once, as ridges ask for.

A disc that is moved and grown together may explain the same crossings better, where neither alone does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.optimize import minimize

if TYPE_CHECKING:
    from collections.abc import Callable

    from odomcorrupt.geometry.se2 import Array

__all__ = ["hilltop"]

_NEAR, _WORTH = 0.03, 0.1
"""Parts of the first steps, and of a unit of what is gained, below which nobody moves any more."""


def hilltop(gain: Callable[[Array], float], start: Array, steps: Array) -> Array:
    """Return where the gain of a shape (s,) is highest near the start; by a simplex, for edges have no slope.

    steps : (s,) how far to look at first (Nelder and Mead 1965)
    """
    found = minimize(
        lambda moved: -gain(start + steps * moved),
        np.zeros(len(start)),
        method="Nelder-Mead",
        options={
            "initial_simplex": np.vstack((np.zeros(len(start)), np.eye(len(start)))),
            "xatol": _NEAR,
            "fatol": _WORTH,
        },
    )
    top: Array = start + steps * found.x
    return top

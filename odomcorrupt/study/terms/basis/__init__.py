"""Basis functions: what an error may depend on where no effect of the library explains it.

Each is a rate: what moves (travel, its size, or turn) times a function of one regressor, such as the speed, a place or
the time. What it acts on, a channel of the body or the wheels, is chosen apart. Thresholds, places and moments are
families with shape parameters; selecting one of many is charged for.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.study.terms.basis.basis_function import COEFFICIENTS, BasisFunction
from odomcorrupt.study.terms.basis.motion import VALUES, functions_of_motion
from odomcorrupt.study.terms.basis.place import functions_of_heading, functions_of_place
from odomcorrupt.study.terms.basis.time import functions_of_time

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Motion

__all__ = ["COEFFICIENTS", "VALUES", "BasisFunction", "basis_functions"]


def basis_functions(motions: Sequence[Motion]) -> list[BasisFunction]:
    """Return every basis function that is tried on these motions."""
    return [
        *functions_of_heading(),
        *functions_of_place(motions),
        *functions_of_time(motions),
        *functions_of_motion(motions),
    ]

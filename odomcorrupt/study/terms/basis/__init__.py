"""Basis functions of one regressor, for errors that no library effect explains.

An error rate is a motion (travel or sideways travel, its absolute value, or turn) times a basis function of one
regressor, such as speed, place or time. Its target, a channel of the body or the wheels, is a separate choice.
Thresholds, places and moments are families with shape parameters; the penalty accounts for the size of the family.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.study.terms.basis.basis_function import COEFFICIENTS, BasisFunction
from odomcorrupt.study.terms.basis.heading import wave_of_heading
from odomcorrupt.study.terms.basis.motion import VALUES, functions_of_motion
from odomcorrupt.study.terms.basis.place import functions_of_place
from odomcorrupt.study.terms.basis.time import functions_of_time

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Motion

__all__ = ["COEFFICIENTS", "VALUES", "BasisFunction", "basis_functions"]


def basis_functions(motions: Sequence[Motion], *, placed: bool = True, sideways: bool = False) -> list[BasisFunction]:
    """Return every basis function to be tried on these motions.

    placed : whether the motions are in one frame, so that functions of heading and place are possible
    sideways : whether the robot drives sideways, so that functions of that speed are possible
    """
    return [
        *((wave_of_heading(1), wave_of_heading(2), *functions_of_place(motions)) if placed else ()),
        *functions_of_time(motions),
        *functions_of_motion(motions, sideways=sideways),
    ]

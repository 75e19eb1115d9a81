"""A basis function: how an error may depend on one regressor, with one coefficient free, or two for a direction."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.geometry.se2 import Array

    Of = Callable[[Motion], Array]

__all__ = ["COEFFICIENTS", "REFINING", "BasisFunction"]

COEFFICIENTS = ("k", "m")
"""Names of the coefficients in an expression."""
REFINING = 2
"""By how much each shape parameter that may be refined multiplies the size of a family."""


@dataclass(frozen=True, slots=True)
class BasisFunction:
    """A function of one regressor.

    regressor : what the error depends on
    text : in the language of expressions, its coefficients named as in `COEFFICIENTS`
    parts : what each coefficient multiplies, of a motion of n intervals (n,)
    trials : size of the family that it is selected from
    wavelength_m : of a wave over the travelled distance, else 0
    form : "step" or "hinge" at a threshold, which are searched apart; else ""
    reaches : what it may act on, see `Action.reaches`; not where the library has that effect
    shape, steps : shape parameters that may be refined, and the first step of a search over each
    with_shape : returns the function with other shape parameters
    related : functions of other shapes to try where this one explains much
    place : where in the truth's plane it acts, in words; "" if it is not confined
    """

    regressor: str
    text: str
    parts: tuple[Of, ...]
    trials: int = 1
    wavelength_m: float = 0.0
    form: str = ""
    reaches: tuple[str, ...] = ("body",)
    shape: tuple[float, ...] = ()
    steps: tuple[float, ...] = ()
    with_shape: Callable[[tuple[float, ...]], BasisFunction] | None = field(default=None, compare=False)
    related: tuple[BasisFunction, ...] = field(default=(), compare=False)
    place: str = field(default="", compare=False)

"""Basis function: an error as a function of one regressor with one free coefficient, or two for a phase."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.geometry.se2 import Array

    Of = Callable[[Motion], Array]

COEFFICIENTS = ("k", "m")
"""Names of the coefficients in an expression."""
REFINING = 2
"""Factor on the size of a family for each shape parameter that may be refined."""


@dataclass(frozen=True, slots=True)
class BasisFunction:
    """A function of one regressor.

    regressor : name of the regressor
    text : expression of an effect, with coefficients named as in `COEFFICIENTS`
    parts : one function per coefficient, from a motion of n intervals to values (n,)
    trials : size of the family that the function is selected from
    form : "step" or "hinge" at a threshold, which are searched separately; else ""
    reaches : classes of targets, see `Action.reaches`, except those for which the library has the effect
    shape, steps : shape parameters that may be refined, and the first step of a search over each
    with_shape : returns the function with other shape parameters
    related : functions of other shapes to be tried if this one has a large gain
    within : returns the function that is zero far from the values (n,) of its regressor, each with an amount of motion
        (n,), on which it was fitted
    place : region in the plane of the truth, or headings, in words; "" if it is not confined
    """

    regressor: str
    text: str
    parts: tuple[Of, ...]
    trials: int = 1
    form: str = ""
    reaches: tuple[str, ...] = ("body",)
    shape: tuple[float, ...] = ()
    steps: tuple[float, ...] = ()
    with_shape: Callable[[tuple[float, ...]], BasisFunction] | None = field(default=None, compare=False)
    related: tuple[BasisFunction, ...] = field(default=(), compare=False)
    within: Callable[[Array, Array], BasisFunction] | None = field(default=None, compare=False)
    place: str = field(default="", compare=False)

"""A law: a function of one driver, with one number free, or two where a direction is meant."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from odomcorrupt.effects.user import user_effect

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.effects.user import UserEffect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.select.channels import Action

    Of = Callable[[Motion], Array]

__all__ = ["NUMBERS", "REFINING", "Law"]

NUMBERS = ("k", "m")
"""What the free numbers of a law are called."""
REFINING = 2
"""By how much each number of a shape that may be refined multiplies what a law was chosen from."""


@dataclass(frozen=True, slots=True)
class Law:
    """A function of one driver.

    text : in the language of expressions, its numbers named as in `NUMBERS`
    parts : what each number multiplies, of a motion of n intervals (n,)
    trials : how many of its family are tried
    wavelength_m : of a wave over the way, else 0
    reaches : what it may act on, see `Action.reaches`; not where the library has that effect
    shape, steps : numbers of a shape that may be refined, and how far to look
    remade : returns the law with another shape
    kin : laws of other shapes to try where this one is good
    """

    driver: str
    text: str
    parts: tuple[Of, ...]
    trials: int = 1
    wavelength_m: float = 0.0
    reaches: tuple[str, ...] = ("body",)
    shape: tuple[float, ...] = ()
    steps: tuple[float, ...] = ()
    remade: Callable[[tuple[float, ...]], Law] | None = field(default=None, compare=False)
    kin: tuple[Law, ...] = field(default=(), compare=False)

    def effect(self, action: Action, values: Sequence[float]) -> UserEffect:
        """Return the law as an effect with these values."""
        named = dict(zip(NUMBERS, map(float, values), strict=False))
        words = {"heading": action.heading} if action.by_wheel else {}
        return user_effect(f"{action.target}_over_{self.driver}", action.written(self.text), named, words=words)

    def expression(self, action: Action, values: Sequence[float]) -> str:
        """Return the expression with its numbers filled in, ready to be edited."""
        text = self.text
        for name, value in zip(NUMBERS, values, strict=False):
            text = text.replace(f"{name} *", f"{float(value):.4g} *")
        return action.written(text)

    def neighbours(self, scale: float) -> Iterator[Law]:
        """Yield the laws with one number of the shape a step of this scale up or down."""
        if self.remade is None:
            return
        for i, step in enumerate(self.steps):
            for sign in (-1.0, 1.0):
                shape = list(self.shape)
                shape[i] += sign * scale * step
                yield self.remade(tuple(shape))

"""Numbers on the command line: finite, within what makes sense, and with the way out where they are not."""

from __future__ import annotations

from math import isfinite
from typing import Any

import click

__all__ = ["TRACK", "Number", "Share"]


class Number(click.ParamType):  # type: ignore[type-arg]  # generic since click 8.5 only
    """A finite number, as FloatRange, which lets what is not a number and what is endless pass.

    low, high : its bounds; high itself is allowed, and low unless `above`
    unit : in words, as in "metres between the wheels"
    """

    name = "float"

    def __init__(
        self, unit: str, low: float = -1e12, high: float = 1e12, *, above: bool = False, else_: str = ""
    ) -> None:
        self._unit, self._low, self._high, self._above = unit, low, high, above
        self._else = f"; {else_}" if else_ else ""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number."""
        try:
            number = float(value)
        except ValueError:
            number = float("nan")
        enough = number > self._low if self._above else number >= self._low
        if not (isfinite(number) and enough and number <= self._high):
            start = f"more than {self._low:g}" if self._above else f"{self._low:g} or more"
            self.fail(f"{value}; write {self._unit}, {start} and at most {self._high:g}{self._else}", param, ctx)
        return number


class Share(Number):
    """A number of which 1 is the whole, also written in percent: 0.003 or 0.3%."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """Return the number."""
        text = str(value).strip()
        if not text.endswith("%"):
            return super().convert(value, param, ctx)
        return super().convert(text[:-1], param, ctx) / 100.0


TRACK = Number("metres between the wheels", 0.0, 99.0, above=True, else_="leave it out where it is not known")

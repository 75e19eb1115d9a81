"""Laws of the unknown: simple functions of one driver that an error may follow where no known effect explains it.

A law is a rate of one channel: what moves (travel, its size, or turn) times a function of the driver, with one number
free, or two where a direction is meant. Thresholds, places and moments are families, and whoever chooses among many
pays for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.user import user_effect

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.effects.user import UserEffect
    from odomcorrupt.pose import Array

    Of = Callable[[Motion], Array]

__all__ = ["CHANNELS", "MOVES", "NUMBERS", "VALUES", "Law", "laws", "moves_of"]

CHANNELS = ("along", "across", "yaw")
NUMBERS = ("k", "m")
"""What the free numbers of a law are called."""
MOVES: dict[str, Of] = {
    "v": lambda m: m.v,
    "abs(v)": lambda m: np.abs(m.v),
    "omega": lambda m: m.omega,
}
VALUES: dict[str, tuple[str, Of]] = {
    "speed": ("abs(v)", lambda m: np.abs(m.v)),
    "yaw_rate": ("abs(omega)", lambda m: np.abs(m.omega)),
    "acceleration": ("a * sign(v)", lambda m: m.a * np.sign(m.v)),
    "yaw_acceleration": ("alpha * sign(omega)", lambda m: m.alpha * np.sign(m.omega)),
    "time": ("t", lambda m: m.t_s),
    "distance": ("distance", lambda m: m.distance),
}
_SIGNED = ("acceleration", "yaw_acceleration", "time")
"""Drivers of which what lies below a threshold is as likely to matter as what lies above."""
_CUTS = np.linspace(0.05, 0.95, 19)
_PLACES = 7
_RADII_M = (0.8, 1.3, 2.0)
_STRIPS = 6
_HALF_WIDTHS_M = (0.4, 0.8)


@dataclass(frozen=True, slots=True)
class Law:
    """A function of one driver.

    text : in the language of expressions, its numbers named as in `NUMBERS`
    parts : what each number multiplies, of a motion of n intervals (n,)
    trials : how many of its family are tried
    wavelength_m : of a wave over the way, else 0
    """

    driver: str
    text: str
    parts: tuple[Of, ...]
    trials: int = 1
    wavelength_m: float = 0.0

    def effect(self, channel: str, move: str, values: Sequence[float]) -> UserEffect:
        """Return the law as an effect with these values."""
        named = dict(zip(NUMBERS, map(float, values), strict=False))
        return user_effect(f"{channel}_over_{self.driver}", f"{channel} += {move} * ({self.text})", named)

    def expression(self, channel: str, move: str, values: Sequence[float]) -> str:
        """Return the expression with its numbers filled in, ready to be edited."""
        text = self.text
        for name, value in zip(NUMBERS, values, strict=False):
            text = text.replace(f"{name} *", f"{float(value):.4g} *")
        return f"{channel} += {move} * ({text})"


def moves_of(channel: str) -> tuple[str, ...]:
    """Return what may move an error of a channel: travel, and for the heading turn, too."""
    return tuple(name for name in MOVES if channel == "yaw" or name != "omega")


def laws(motions: Sequence[Motion]) -> list[Law]:
    """Return every law that is tried on these motions."""
    found = [*_headings(), *_discs(motions), *_strips(motions)]
    for driver, (text, value) in VALUES.items():
        found.append(Law(driver, f"k * {text}", (value,)))
        if driver != "distance":  # that is time, by another name
            found += _steps(driver, text, value, motions)
    return found


def _headings() -> Iterator[Law]:
    for times, inner in ((1, "theta"), (2, "2 * theta")):
        yield Law("heading", f"k * cos({inner}) + m * sin({inner})", (_wave(np.cos, times), _wave(np.sin, times)), 2)


def _steps(driver: str, text: str, value: Of, motions: Sequence[Motion]) -> Iterator[Law]:
    """Yield thresholds of a driver, spread evenly over what it was while the robot moved."""
    seen = np.concatenate([value(m)[(np.abs(m.v) > 0.02) | (np.abs(m.omega) > 0.02)] for m in motions])
    if len(seen) == 0:
        return
    cuts = np.unique(np.quantile(seen, _CUTS))
    both = driver in _SIGNED
    for cut in cuts:
        trials = len(cuts) * (2 if both else 1)
        yield Law(driver, f"k * where({text} > {cut:.4g}, 1, 0)", (_above(value, cut),), trials)
        if both:
            yield Law(driver, f"k * where({text} < {cut:.4g}, 1, 0)", (_below(value, cut),), trials)


def _discs(motions: Sequence[Motion]) -> Iterator[Law]:
    xs, ys = (_spread(np.concatenate([getattr(m, axis) for m in motions])) for axis in ("x", "y"))
    for x, y, radius in product(xs, ys, _RADII_M):
        text = f"k * where(hypot(x {_less(x)}, y {_less(y)}) < {radius:.4g}, 1, 0)"
        yield Law("position", text, (_within(x, y, radius),), 2 * _PLACES**2 * len(_RADII_M))


def _strips(motions: Sequence[Motion]) -> Iterator[Law]:
    for angle in np.pi * np.arange(_STRIPS) / _STRIPS:
        c, s = np.cos(angle), np.sin(angle)
        middles = _spread(np.concatenate([c * m.x + s * m.y for m in motions]))
        for middle, half in product(middles, _HALF_WIDTHS_M):
            text = f"k * where(abs({c:.4g} * x + {s:.4g} * y {_less(middle)}) < {half:.4g}, 1, 0)"
            yield Law("position", text, (_band(c, s, middle, half),), 2 * _STRIPS * _PLACES * len(_HALF_WIDTHS_M))


def _less(value: float) -> str:
    return f"- {value:.4g}" if value >= 0.0 else f"+ {-value:.4g}"


def _spread(values: Array) -> Array:
    """Return places (_PLACES,) along an axis that span nearly all of the values."""
    low, high = np.quantile(values, 0.03), np.quantile(values, 0.97)
    return np.linspace(float(low), float(high), _PLACES)


def _wave(function: Callable[[Array], Array], times: int) -> Of:
    return lambda m: function(times * m.theta)


def _above(value: Of, cut: float) -> Of:
    return lambda m: (value(m) > cut).astype(np.float64)


def _below(value: Of, cut: float) -> Of:
    return lambda m: (value(m) < cut).astype(np.float64)


def _within(x: float, y: float, radius: float) -> Of:
    return lambda m: (np.hypot(m.x - x, m.y - y) < radius).astype(np.float64)


def _band(c: float, s: float, middle: float, half: float) -> Of:
    return lambda m: (np.abs(c * m.x + s * m.y - middle) < half).astype(np.float64)

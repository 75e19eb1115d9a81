"""Laws of the unknown: simple functions of one driver that an error may follow where no known effect explains it.

A law is a rate: what moves (travel, its size, or turn) times a function of the driver, with one number free, or two
where a direction is meant. Where it acts, on a channel of the body or on wheels, is said apart. Thresholds, places and
moments are families, and whoever chooses among many pays for it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.user import user_effect

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.effects.user import UserEffect
    from odomcorrupt.pose import Array
    from odomcorrupt.study.search.actions import Action

    Of = Callable[[Motion], Array]

__all__ = ["NUMBERS", "VALUES", "Law", "laws"]

NUMBERS = ("k", "m")
"""What the free numbers of a law are called."""
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
_OF_WHEELS = ("speed", "acceleration", "time")
"""Drivers that a wheel has of its own; and time, which may load one side."""
_CUTS = np.linspace(0.05, 0.95, 19)
_PLACES = 7
_RADII_M = (0.8, 1.3, 2.0)
_STRIPS = 6
_HALF_WIDTHS_M = (0.4, 0.8)
_REFINING = 2
"""By how much each number of a shape that may be refined multiplies what a law was chosen from."""


@dataclass(frozen=True, slots=True)
class Law:
    """A function of one driver.

    text : in the language of expressions, its numbers named as in `NUMBERS`
    parts : what each number multiplies, of a motion of n intervals (n,)
    trials : how many of its family are tried
    wavelength_m : of a wave over the way, else 0
    reaches : what it may act on, of "body", "one" wheel and "both"; not where the library has that effect
    shape, steps : numbers of a shape that may be refined, and how far to look
    remade : returns the law with another shape
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

    def effect(self, action: Action, values: Sequence[float]) -> UserEffect:
        """Return the law as an effect with these values."""
        named = dict(zip(NUMBERS, map(float, values), strict=False))
        words = {"heading": action.heading} if action.by_wheel else {}
        text = f"{action.target} += {action.move} * ({self.text})"
        return user_effect(f"{action.target}_over_{self.driver}", text, named, words=words)

    def expression(self, action: Action, values: Sequence[float]) -> str:
        """Return the expression with its numbers filled in, ready to be edited."""
        text = self.text
        for name, value in zip(NUMBERS, values, strict=False):
            text = text.replace(f"{name} *", f"{float(value):.4g} *")
        return f"{action.target} += {action.move} * ({text})"

    def neighbours(self, scale: float) -> Iterator[Law]:
        """Yield the laws with one number of the shape a step of this scale up or down."""
        if self.remade is None:
            return
        for i, step in enumerate(self.steps):
            for sign in (-1.0, 1.0):
                shape = list(self.shape)
                shape[i] += sign * scale * step
                yield self.remade(tuple(shape))


def laws(motions: Sequence[Motion]) -> list[Law]:
    """Return every law that is tried on these motions."""
    found = [*_headings(), *_discs(motions), *_strips(motions)]
    for driver, (text, value) in VALUES.items():
        found.append(
            Law(driver, f"k * {text}", (value,), reaches=("body", "one") if driver in _OF_WHEELS else ("body",))
        )
        if driver != "distance":  # that is time, by another name
            found += _thresholds(driver, motions)
    return found


def _headings() -> Iterator[Law]:
    for times, inner in ((1, "theta"), (2, "2 * theta")):
        yield Law("heading", f"k * cos({inner}) + m * sin({inner})", (_wave(np.cos, times), _wave(np.sin, times)), 2)


def _thresholds(driver: str, motions: Sequence[Motion]) -> Iterator[Law]:
    """Yield thresholds of a driver, spread evenly over what it was while the robot moved."""
    value = VALUES[driver][1]
    seen = np.concatenate([value(m)[(np.abs(m.v) > 0.02) | (np.abs(m.omega) > 0.02)] for m in motions])
    if len(seen) == 0:
        return
    cuts = np.unique(np.quantile(seen, _CUTS))
    ways = (True, False) if driver in _SIGNED else (True,)
    for above, (i, cut) in product(ways, enumerate(cuts)):
        gap = float(np.max(np.diff(cuts[max(i - 1, 0) : i + 2]), initial=0.0))
        yield _threshold(driver, len(cuts) * len(ways), (float(cut),), (0.5 * gap,), above=above)


def _threshold(driver: str, trials: int, shape: tuple[float, ...], steps: tuple[float, ...], *, above: bool) -> Law:
    text, value = VALUES[driver]
    (cut,) = shape
    return Law(
        driver,
        f"k * where({text} {'>' if above else '<'} {cut:.4g}, 1, 0)",
        ((_above if above else _below)(value, cut),),
        trials * _REFINING,
        reaches=("body", "one", "both") if driver in _OF_WHEELS else ("body",),
        shape=shape,
        steps=steps,
        remade=lambda moved: _threshold(driver, trials, moved, steps, above=above),
    )


def _discs(motions: Sequence[Motion]) -> Iterator[Law]:
    xs, ys = (_spread(np.concatenate([getattr(m, axis) for m in motions])) for axis in ("x", "y"))
    for x, y, radius in product(xs, ys, _RADII_M):
        yield _disc((float(x), float(y), radius))


def _disc(shape: tuple[float, ...]) -> Law:
    x, y, radius = shape[0], shape[1], max(shape[2], 0.1)
    return Law(
        "position",
        f"k * where(hypot(x {_less(x)}, y {_less(y)}) < {radius:.4g}, 1, 0)",
        (_within(x, y, radius),),
        2 * _PLACES**2 * len(_RADII_M) * _REFINING**3,
        shape=shape,
        steps=(0.4, 0.4, 0.3),
        remade=_disc,
    )


def _strips(motions: Sequence[Motion]) -> Iterator[Law]:
    for angle in np.pi * np.arange(_STRIPS) / _STRIPS:
        c, s = np.cos(angle), np.sin(angle)
        middles = _spread(np.concatenate([c * m.x + s * m.y for m in motions]))
        for middle, half in product(middles, _HALF_WIDTHS_M):
            yield _strip((float(angle), float(middle), half))


def _strip(shape: tuple[float, ...]) -> Law:
    angle, middle, half = shape[0], shape[1], max(shape[2], 0.05)
    c, s = float(np.cos(angle)), float(np.sin(angle))
    return Law(
        "position",
        f"k * where(abs({c:.4g} * x + {s:.4g} * y {_less(middle)}) < {half:.4g}, 1, 0)",
        (_band(c, s, middle, half),),
        2 * _STRIPS * _PLACES * len(_HALF_WIDTHS_M) * _REFINING**3,
        reaches=("body", "both"),
        shape=shape,
        steps=(0.2, 0.4, 0.2),
        remade=_strip,
    )


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

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
_OF_A_BIAS = ("speed", "yaw_rate", "time")
"""Drivers that a rate of the heading may depend on which is there at rest, too: a gyro's."""
_HINGED = ("speed", "yaw_rate", "acceleration")
_STILL = 0.02
"""m/s and rad/s below which a robot stands."""
_SETTLE_S = (30.0, 80.0, 200.0)
_SHORTEST_SWING_S, _SWING_STEP = 40.0, 0.2
"""The quickest swing of minutes, and the step of the logarithm of its period."""
_CUTS = np.linspace(0.05, 0.95, 19)
_PLACES = 7
_RADII_M = (0.8, 1.3, 2.0)
_OUTER = (0.03, 0.97)
"""Parts of the way between which places are looked for."""
_STRIPS = 12
_STRIP_APART_M, _MOST_STRIPS = 0.8, 25
_THIN = 10
"""Of so many places one is enough to see where the robot was."""
_HALF_WIDTHS_M = (0.4, 0.8)
_BOX_ANGLES = (0.0, np.pi / 6.0, np.pi / 3.0)
_REFINING = 2
"""By how much each number of a shape that may be refined multiplies what a law was chosen from."""


@dataclass(frozen=True, slots=True)
class Law:
    """A function of one driver.

    text : in the language of expressions, its numbers named as in `NUMBERS`
    parts : what each number multiplies, of a motion of n intervals (n,)
    trials : how many of its family are tried
    wavelength_m : of a wave over the way, else 0
    reaches : what it may act on, of "body", "one" wheel, "both", a "bias" and the "ground"; not where the library has
        that effect
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


def laws(motions: Sequence[Motion]) -> list[Law]:
    """Return every law that is tried on these motions."""
    found = [*_headings(), *_discs(motions), *_strips(motions), *_settlings(), *_swings(motions), *_at_rest()]
    for driver, (text, value) in VALUES.items():
        found.append(Law(driver, f"k * {text}", (value,), reaches=_reaches(driver, "one")))
        if driver != "distance":  # that is time, by another name
            found += _thresholds(driver, motions)
        if driver in _HINGED:
            found += _hinges(driver, motions)
    return found


def _reaches(driver: str, *wheels: str) -> tuple[str, ...]:
    """Return what a law of this driver may act on, wheels where they have a driver of their own."""
    return ("body", *(wheels if driver in _OF_WHEELS else ()), *(("bias",) if driver in _OF_A_BIAS else ()))


def _headings() -> Iterator[Law]:
    for times, inner in ((1, "theta"), (2, "2 * theta")):
        yield Law("heading", f"k * cos({inner}) + m * sin({inner})", (_wave(np.cos, times), _wave(np.sin, times)), 2)


def _thresholds(driver: str, motions: Sequence[Motion]) -> Iterator[Law]:
    """Yield thresholds of a driver, spread evenly over what it was while the robot moved."""
    cuts = _cuts(driver, motions)
    ways = (True, False) if driver in _SIGNED else (True,)
    for above, (i, cut) in product(ways, enumerate(cuts)):
        gap = float(np.max(np.diff(cuts[max(i - 1, 0) : i + 2]), initial=0.0))
        yield _threshold(driver, len(cuts) * len(ways), (float(cut),), (0.5 * gap,), above=above)


def _cuts(driver: str, motions: Sequence[Motion]) -> Array:
    """Return values of a driver while the robot moved, evenly spread; and of a speed, where it begins to move."""
    value = VALUES[driver][1]
    seen = np.concatenate([value(m)[(np.abs(m.v) > _STILL) | (np.abs(m.omega) > _STILL)] for m in motions])
    cuts = np.quantile(seen, _CUTS) if len(seen) else np.zeros(0)
    return np.unique(np.append(cuts, _STILL) if driver in ("speed", "yaw_rate") else cuts)


def _threshold(driver: str, trials: int, shape: tuple[float, ...], steps: tuple[float, ...], *, above: bool) -> Law:
    text, value = VALUES[driver]
    (cut,) = shape
    return Law(
        driver,
        f"k * where({text} {'>' if above else '<'} {cut:.4g}, 1, 0)",
        ((_above if above else _below)(value, cut),),
        trials * _REFINING,
        reaches=_reaches(driver, "one", "both"),
        shape=shape,
        steps=steps,
        remade=lambda moved: _threshold(driver, trials, moved, steps, above=above),
    )


def _hinges(driver: str, motions: Sequence[Motion]) -> Iterator[Law]:
    """Yield what grows from a threshold on: grip that gives way; of what has two sides, on either."""
    cuts = [cut for cut in _cuts(driver, motions)[1::3] if cut > 0.0]
    two_sided = driver in _SIGNED
    shapes = [(sign, float(cut)) for sign in ((1.0, -1.0) if two_sided else (1.0,)) for cut in (0.0, *cuts)]
    for sign, cut in shapes:
        if cut > 0.0 or two_sided:
            yield _hinge(driver, len(shapes), (cut,), (0.15 * max(cuts, default=1.0),), sign=sign)


def _hinge(driver: str, trials: int, shape: tuple[float, ...], steps: tuple[float, ...], *, sign: float) -> Law:
    text, value = VALUES[driver]
    cut = max(shape[0], 0.0)
    return Law(
        driver,
        f"k * max({text if sign > 0.0 else f'-{text}'} - {cut:.4g}, 0)",
        (lambda m: np.maximum(sign * value(m) - cut, 0.0),),
        trials * _REFINING,
        reaches=_reaches(driver, "one", "both"),
        shape=shape,
        steps=steps,
        remade=lambda moved: _hinge(driver, trials, moved, steps, sign=sign),
    )


def _settlings() -> Iterator[Law]:
    """Yield what dies away, and what comes up: tyres, motors and sensors that warm up."""
    for tau_s, rising in product(_SETTLE_S, (False, True)):
        yield _settling((float(np.log(tau_s)),), rising=rising)


def _settling(shape: tuple[float, ...], *, rising: bool) -> Law:
    tau_s = float(np.exp(np.clip(shape[0], 1.0, 9.0)))
    return Law(
        "time",
        f"k * (1 - exp(-t / {tau_s:.4g}))" if rising else f"k * exp(-t / {tau_s:.4g})",
        (lambda m: float(rising) + (-1.0 if rising else 1.0) * np.exp(-m.t_s / tau_s),),
        2 * len(_SETTLE_S) * _REFINING,
        reaches=_reaches("time", "one", "both"),
        shape=shape,
        steps=(0.5,),
        remade=lambda moved: _settling(moved, rising=rising),
    )


def _swings(motions: Sequence[Motion]) -> Iterator[Law]:
    """Yield what comes and goes in minutes: sun and shade, a load that is shared."""
    longest_s = max(float(np.ptp(m.t_s)) for m in motions)
    count = int(np.ceil(np.log(max(longest_s / _SHORTEST_SWING_S, 1.0)) / _SWING_STEP)) + 1
    for i in range(count):
        yield _swing((float(np.log(longest_s)) - i * _SWING_STEP,), count)


def _swing(shape: tuple[float, ...], count: int) -> Law:
    pace = 2.0 * np.pi / float(np.exp(shape[0]))
    return Law(
        "time",
        f"k * cos({pace:.6g} * t) + m * sin({pace:.6g} * t)",
        (lambda m: np.cos(pace * m.t_s), lambda m: np.sin(pace * m.t_s)),
        count * _REFINING,
        reaches=_reaches("time"),
        shape=shape,
        steps=(0.5 * _SWING_STEP,),
        remade=lambda moved: _swing(moved, count),
    )


def _discs(motions: Sequence[Motion]) -> Iterator[Law]:
    xs, ys = (_spread(np.concatenate([getattr(m, axis) for m in motions])) for axis in ("x", "y"))
    for x, y, radius in product(xs, ys, _RADII_M):
        yield _disc((float(x), float(y), radius))


def _at_rest() -> Iterator[Law]:
    """Yield what is there while the robot stands, does not drive, or does not turn."""
    for driver in ("speed", "yaw_rate"):
        text, value = VALUES[driver]
        yield Law(driver, f"k * where({text} < {_STILL:.4g}, 1, 0)", (_below(value, _STILL),), reaches=("bias",))
    still = _below(lambda m: np.maximum(np.abs(m.v), np.abs(m.omega)), _STILL)
    yield Law("speed", f"k * where(max(abs(v), abs(omega)) < {_STILL:.4g}, 1, 0)", (still,), reaches=("bias",))


def _disc(shape: tuple[float, ...]) -> Law:
    x, y, radius = shape[0], shape[1], max(shape[2], 0.1)
    return Law(
        "position",
        f"k * where(hypot(x {_less(x)}, y {_less(y)}) < {radius:.4g}, 1, 0)",
        (_within(x, y, radius),),
        2 * _PLACES**2 * len(_RADII_M) * _REFINING**3,
        reaches=("body", "ground"),
        shape=shape,
        steps=(0.4, 0.4, 0.3),
        remade=_disc,
        kin=tuple(_box((angle, x, y, radius, radius)) for angle in _BOX_ANGLES),
    )


def _strips(motions: Sequence[Motion]) -> Iterator[Law]:
    """Yield strips across what was visited, each turned about the middle of where the robot was in it."""
    x, y = (np.concatenate([getattr(m, axis)[::_THIN] for m in motions]) for axis in ("x", "y"))
    for angle in np.pi * np.arange(_STRIPS) / _STRIPS:
        c, s = np.cos(angle), np.sin(angle)
        place = c * x + s * y
        low, high = np.quantile(place, _OUTER)
        middles = np.linspace(low, high, int(np.clip((high - low) / _STRIP_APART_M, _PLACES, _MOST_STRIPS)))
        for middle, half in product(middles, _HALF_WIDTHS_M):
            inside = np.abs(place - middle) < half
            if inside.any():
                way = float(np.mean(c * y[inside] - s * x[inside]))
                yield _strip((float(angle), float(c * middle - s * way), float(s * middle + c * way), half))


def _strip(shape: tuple[float, ...]) -> Law:
    """Return a strip: the angle of what points across it, a place on its middle line, and half its width."""
    angle, x, y, half = *shape[:3], max(shape[3], 0.05)
    c, s = float(np.cos(angle)), float(np.sin(angle))
    middle = c * x + s * y
    return Law(
        "position",
        f"k * where(abs({c:.4g} * x + {s:.4g} * y {_less(middle)}) < {half:.4g}, 1, 0)",
        (_band(c, s, middle, half),),
        2 * _STRIPS * _MOST_STRIPS * len(_HALF_WIDTHS_M) * _REFINING**3,
        reaches=("body", "both", "ground"),
        shape=(angle, x, y, half),
        steps=(0.2, 0.4, 0.4, 0.2),
        remade=_strip,
    )


def _box(shape: tuple[float, ...]) -> Law:
    """Return a rectangle: angle of its first axis, middle, and half of either side."""
    angle, x, y = shape[0], shape[1], shape[2]
    half, side = max(shape[3], 0.1), max(shape[4], 0.1)
    c, s = float(np.cos(angle)), float(np.sin(angle))
    along, across = c * x + s * y, c * y - s * x
    return Law(
        "position",
        f"k * where(abs({c:.4g} * x + {s:.4g} * y {_less(along)}) < {half:.4g}, 1, 0)"
        f" * where(abs({c:.4g} * y - {s:.4g} * x {_less(across)}) < {side:.4g}, 1, 0)",
        (lambda m: _band(c, s, along, half)(m) * _band(-s, c, across, side)(m),),
        2 * _PLACES**2 * len(_RADII_M) * len(_BOX_ANGLES) * _REFINING**5,
        reaches=("body", "both", "ground"),
        shape=(angle, x, y, half, side),
        steps=(0.2, 0.4, 0.4, 0.4, 0.4),
        remade=_box,
    )


def _less(value: float) -> str:
    return f"- {value:.4g}" if value >= 0.0 else f"+ {-value:.4g}"


def _spread(values: Array) -> Array:
    """Return places (_PLACES,) along an axis that span nearly all of the values."""
    low, high = np.quantile(values, _OUTER)
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

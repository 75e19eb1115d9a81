"""Basis functions of place: discs, rectangles and strips of floor, and iron that deflects a compass."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.terms.basis.basis_function import REFINING, BasisFunction

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.terms.basis.basis_function import Of

_PLACES = 7  # grid lines along each axis
_RADII_M = (0.8, 1.3, 2.0)  # radii of discs, m
_OUTER = (0.03, 0.97)
"""Quantiles of the path's coordinates between which places are tried."""
_STRIPS = 12  # directions of strips over half a turn
_STRIP_APART_M, _MOST_STRIPS = 0.8, 25  # spacing of parallel strips, m, and their largest number
_THIN = 10
"""One of this many poses is used to find where strips contain the path."""
_HALF_WIDTHS_M = (0.4, 0.8)  # of strips, m
_STRIP_SHAPE, _BOX_SHAPE = 4, 5
"""Number of shape parameters of a strip and of a rectangle."""
_BOX_ANGLES = (0.0, np.pi / 6.0, np.pi / 3.0)  # of rectangles, rad


def functions_of_place(motions: Sequence[Motion]) -> Iterator[BasisFunction]:
    """Yield every function of the place to be tried on these motions."""
    xs, ys = (spread(np.concatenate([getattr(m, axis) for m in motions]), _OUTER, _PLACES) for axis in ("x", "y"))
    for x, y, radius in product(xs, ys, _RADII_M):
        yield _disc((float(x), float(y), radius))
        yield _iron((float(x), float(y), 0.5 * radius))
    yield from _strips(motions)


def _disc(shape: tuple[float, ...]) -> BasisFunction:
    x, y, radius = shape[0], shape[1], max(shape[2], 0.1)
    return BasisFunction(
        "position",
        f"k * where(hypot(x {_less(x)}, y {_less(y)}) < {radius:.4g}, 1, 0)",
        (_within(x, y, radius),),
        2 * _PLACES**2 * len(_RADII_M) * REFINING**3,
        reaches=("floor", "ground", "bias"),
        shape=shape,
        steps=(0.4, 0.4, 0.3),
        with_shape=_disc,
        place=f"within {radius:.2g} m of ({x:.1f}, {y:.1f})",
        related=tuple(_box((angle, x, y, radius, radius)) for angle in _BOX_ANGLES),
    )


def _iron(shape: tuple[float, ...]) -> BasisFunction:
    """Return the yaw error per travel of a compass near iron, with a deflection that is bell-shaped in the distance."""
    x, y, reach = shape[0], shape[1], max(shape[2], 0.1)

    def nearing(m: Motion) -> Array:
        ahead = (x - m.x) * np.cos(m.theta) + (y - m.y) * np.sin(m.theta)
        return ahead * np.exp(-((m.x - x) ** 2 + (m.y - y) ** 2) / (2.0 * reach**2))

    right, up = f"(x {_less(x)})", f"(y {_less(y)})"
    bell = f"exp(-({right}**2 + {up}**2) / {2.0 * reach**2:.4g})"
    return BasisFunction(
        "position",
        f"k * -({right} * cos(theta) + {up} * sin(theta)) * {bell}",
        (nearing,),
        2 * _PLACES**2 * len(_RADII_M) * REFINING**3,
        reaches=("heading",),
        shape=(x, y, reach),
        steps=(0.4, 0.4, 0.2),
        with_shape=_iron,
    )


def _strips(motions: Sequence[Motion]) -> Iterator[BasisFunction]:
    """Yield strips across the visited area; each is turned, in a search, about the mean of the path inside it."""
    x, y = (np.concatenate([getattr(m, axis)[::_THIN] for m in motions]) for axis in ("x", "y"))
    for angle in np.pi * np.arange(_STRIPS) / _STRIPS:
        c, s = _axis(float(angle))
        place = c * x + s * y
        low, high = np.quantile(place, _OUTER)
        middles = np.linspace(low, high, int(np.clip((high - low) / _STRIP_APART_M, _PLACES, _MOST_STRIPS)))
        for middle, half in product(middles, _HALF_WIDTHS_M):
            inside = np.abs(place - middle) < half
            if inside.any():
                way = float(np.mean(c * y[inside] - s * x[inside]))
                yield _strip((float(angle), float(c * middle - s * way), float(s * middle + c * way), half))


def _strip(shape: tuple[float, ...]) -> BasisFunction:
    """Return a strip from the angle of its normal, a point on its centre line, and half its width."""
    angle, x, y, half = *shape[:3], max(shape[3], 0.05)
    axis = _axis(angle)
    return BasisFunction(
        "position",
        f"k * where(abs({_ahead(axis, x, y)}) < {half:.4g}, 1, 0)",
        (_band(axis, x, y, half),),
        2 * _STRIPS * _MOST_STRIPS * len(_HALF_WIDTHS_M) * REFINING**3,
        reaches=("floor", "both", "ground"),
        shape=(angle, x, y, half),
        steps=(0.2, 0.4, 0.4, 0.2),
        with_shape=_strip,
        place=f"in a strip {2.0 * half:.2g} m wide through ({x:.1f}, {y:.1f})",
    )


def _box(shape: tuple[float, ...]) -> BasisFunction:
    """Return a rectangle from the angle of its first axis, its centre, and half the length of each side."""
    angle, x, y = shape[0], shape[1], shape[2]
    half, side = max(shape[3], 0.1), max(shape[4], 0.1)
    c, s = along = _axis(angle)
    across = (-s, c)
    return BasisFunction(
        "position",
        f"k * where(abs({_ahead(along, x, y)}) < {half:.4g}, 1, 0)"
        f" * where(abs({_ahead(across, x, y)}) < {side:.4g}, 1, 0)",
        (lambda m: _band(along, x, y, half)(m) * _band(across, x, y, side)(m),),
        2 * _PLACES**2 * len(_RADII_M) * len(_BOX_ANGLES) * REFINING**5,
        reaches=("floor", "both", "ground", "bias"),
        shape=(angle, x, y, half, side),
        steps=(0.2, 0.4, 0.4, 0.4, 0.4),
        with_shape=_box,
        place=f"in a rectangle of {2.0 * half:.2g} by {2.0 * side:.2g} m around ({x:.1f}, {y:.1f})",
    )


def rectangle_of(function: BasisFunction) -> tuple[float, float, float, float, float] | None:
    """Return angle of the first axis, centre and half sides of a strip or rectangle, rad and m; None for others.

    The second side of a strip is infinite.
    """
    if function.regressor != "position" or len(function.shape) not in (_STRIP_SHAPE, _BOX_SHAPE):
        return None
    angle, x, y, half, side = (*function.shape, np.inf)[:_BOX_SHAPE]
    return angle, x, y, half, side


def _axis(angle: float) -> tuple[float, float]:
    """Return the unit vector at an angle, rounded so that expressions contain no floating-point residue."""
    c, s = np.round((np.cos(angle), np.sin(angle)), 6) + 0.0
    return float(c), float(s)


def _ahead(axis: tuple[float, float], x: float, y: float) -> str:
    """Return the expression of the coordinate along an axis, relative to a place."""
    (c, s), sign = axis, "-" if axis[1] < 0.0 else "+"
    return f"{c:.4g} * (x {_less(x)}) {sign} {abs(s):.4g} * (y {_less(y)})"


def _less(metres: float) -> str:
    """Return the text that subtracts a length, to a millimetre: some maps have coordinates of 500 km."""
    return f"{'-' if metres >= 0.0 else '+'} {round(abs(metres), 3):.10g}"


def spread(values: Array, outer: tuple[float, float], count: int) -> Array:
    """Return places (count,) along an axis between two quantiles of the values."""
    low, high = np.quantile(values, outer)
    return np.linspace(float(low), float(high), count)


def _within(x: float, y: float, radius: float) -> Of:
    return lambda m: (np.hypot(m.x - x, m.y - y) < radius).astype(np.float64)


def _band(axis: tuple[float, float], x: float, y: float, half: float) -> Of:
    c, s = axis
    return lambda m: (np.abs(c * (m.x - x) + s * (m.y - y)) < half).astype(np.float64)

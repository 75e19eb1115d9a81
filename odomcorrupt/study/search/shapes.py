"""Expressions for what is unknown: simple laws of one driver, each fitted itself, the plainest of them written down.

A curve says on what an error depends; a law that a user can add says how. The laws are a rate of a channel: what moves
(travel, its size, or turn) times a simple function of the driver, one number free, or two where a heading is meant.
Thresholds, places and moments are scanned and charged for.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.search.score import score_columns

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.pose import Array
    from odomcorrupt.study.fitting.gauss_newton import Fit

__all__ = ["plainest_law"]

CHANNELS = ("along", "across", "yaw")
_MOVES: dict[str, Callable[[Motion], Array]] = {
    "v": lambda m: m.v,
    "abs(v)": lambda m: np.abs(m.v),
    "omega": lambda m: m.omega,
}
_VALUES: dict[str, tuple[str, Callable[[Motion], Array]]] = {
    "speed": ("abs(v)", lambda m: np.abs(m.v)),
    "yaw_rate": ("abs(omega)", lambda m: np.abs(m.omega)),
    "acceleration": ("a * sign(v)", lambda m: m.a * np.sign(m.v)),
    "yaw_acceleration": ("alpha * sign(omega)", lambda m: m.alpha * np.sign(m.omega)),
    "time": ("t", lambda m: m.t_s),
    "distance": ("distance", lambda m: m.distance),
}
_CUTS = np.linspace(0.1, 0.9, 9)
_PLACES = 7
_RADII_M = (0.8, 1.3, 2.0)


@dataclass(frozen=True, slots=True)
class _Law:
    """A function of the motion with its text, of one number {0} or of two; `trials` are those of its family."""

    text: str
    parts: tuple[Callable[[Motion], Array], ...]
    trials: int = 1


def plainest_law(fit: Fit, believed: Array, driver: str, channel: str) -> str | None:
    """Return the expression of the law of this driver and channel that explains most for its price, or None."""
    motions, nodes = fit.problem.motions, fit.problem.nodes
    moves = [name for name in _MOVES if channel == "yaw" or name != "omega"]
    c, laws, groups = CHANNELS.index(channel), [], []
    for law, move in product(_laws(driver, motions), moves):
        columns = []
        for part in law.parts:
            error = np.zeros((sum(len(m) for m in motions), 3))
            error[:, c] = -np.concatenate([part(m) * _MOVES[move](m) * m.dt_s for m in motions])
            columns.append(nodes.column(error))
        if all(np.abs(column).max() > 0.0 for column in columns):
            laws.append((law, move))
            groups.append(np.stack(columns, axis=2))
    if not groups:
        return None
    best, worth = None, -np.inf
    for (law, move), score in zip(laws, score_columns(fit, groups, believed), strict=True):
        price = 0.5 * len(law.parts) * np.log(len(nodes)) + np.log(law.trials)
        if score.separable and 0.5 * score.statistic / score.inflation - price > worth:
            worth = 0.5 * score.statistic / score.inflation - price
            best = f"{channel} += {move} * ({law.text.format(*(f'{float(k):.4g}' for k in score.estimate))})"
    return best


def _laws(driver: str, motions: tuple[Motion, ...]) -> Iterator[_Law]:
    if driver == "heading":
        for times, inner in ((1, "theta"), (2, "2 * theta")):
            yield _Law(f"{{0}} * cos({inner}) + {{1}} * sin({inner})", (_wave(np.cos, times), _wave(np.sin, times)))
    elif driver == "position":
        yield from _discs(motions)
    else:
        text, value = _VALUES[driver]
        yield _Law(f"{{0}} * {text}", (value,))
        cuts = np.unique(np.quantile(np.concatenate([value(m)[np.abs(m.v) > 0.02] for m in motions]), _CUTS))
        for cut in cuts:
            yield _Law(f"{{0}} * where({text} > {cut:.4g}, 1, 0)", (_above(value, cut),), 2 * len(cuts))
            if driver in ("acceleration", "yaw_acceleration"):
                yield _Law(f"{{0}} * where({text} < {cut:.4g}, 1, 0)", (_below(value, cut),), 2 * len(cuts))


def _discs(motions: tuple[Motion, ...]) -> Iterator[_Law]:
    xs, ys = (_spread(np.concatenate([getattr(m, axis) for m in motions])) for axis in ("x", "y"))
    for x, y, radius in product(xs, ys, _RADII_M):
        text = f"{{0}} * where(hypot(x - {x:.4g}, y - {y:.4g}) < {radius:.4g}, 1, 0)"
        yield _Law(text.replace("- -", "+ "), (_within(x, y, radius),), _PLACES**2 * len(_RADII_M))


def _spread(values: Array) -> Array:
    """Return places (_PLACES,) along an axis that span nearly all of the values."""
    low, high = np.quantile(values, 0.03), np.quantile(values, 0.97)
    return np.linspace(float(low), float(high), _PLACES)


def _wave(function: Callable[[Array], Array], times: int) -> Callable[[Motion], Array]:
    return lambda m: function(times * m.theta)


def _above(value: Callable[[Motion], Array], cut: float) -> Callable[[Motion], Array]:
    return lambda m: (value(m) > cut).astype(np.float64)


def _below(value: Callable[[Motion], Array], cut: float) -> Callable[[Motion], Array]:
    return lambda m: (value(m) < cut).astype(np.float64)


def _within(x: float, y: float, radius: float) -> Callable[[Motion], Array]:
    return lambda m: (np.hypot(m.x - x, m.y - y) < radius).astype(np.float64)

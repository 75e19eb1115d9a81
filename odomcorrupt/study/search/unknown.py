"""What is left when no known effect explains it: the driver on which the error depends, and the curve.

For every driver (speed, yaw rate, ...) and channel the error per metre is let free as a curve of a few hat functions;
the curve's joint score says whether it is there, its estimate is what the user sees.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.search.score import score_columns
from odomcorrupt.study.search.shapes import plainest_law

if TYPE_CHECKING:
    from collections.abc import Callable

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.pose import Array
    from odomcorrupt.study.fitting.gauss_newton import Fit
    from odomcorrupt.study.search.score import ColumnScore

__all__ = ["Unknown", "unknown_dependences"]

CHANNELS = ("along", "across", "yaw")
_HATS = {"speed": 6, "yaw_rate": 6, "acceleration": 6, "yaw_acceleration": 6, "time": 8, "distance": 8}
_GRID = 4
_LEVEL = 0.01
_WRITTEN = 2
"""How many dependences get a law that is fitted itself; the others a line through their curve."""


@dataclass(frozen=True, slots=True)
class Unknown:
    """An error of one channel that follows one driver.

    centres : (m,) values of the driver, or (m, 2) places
    curve, curve_error : (m,) error of truth minus odometry per metre driven (m/m or rad/m) there, and its error
    p : probability of such a curve anywhere without any dependence
    nats : log likelihood that the curve gains
    expression : a simple effect of that shape, ready to be edited
    """

    channel: str
    driver: str
    centres: Array
    curve: Array
    curve_error: Array
    p: float
    nats: float
    expression: str


def unknown_dependences(fit: Fit, believed: Array) -> list[Unknown]:
    """Return the dependences that nothing believed explains, the plainest first; usually none."""
    problem = fit.problem
    shapes = {name: [shape(m) for m in problem.motions] for name, shape in _drivers(fit).items()}
    names, groups, centres = [], [], []
    for name, per_run in shapes.items():
        joined = np.concatenate([values for values, _ in per_run])
        where = per_run[0][1]
        metres = np.concatenate([np.hypot(m.v, m.vy) * m.dt_s for m in problem.motions])
        held = joined * metres[:, None]
        used = np.abs(held).sum(axis=0) > 0.01 * metres.sum()
        if used.sum() < 2:
            continue
        for c, channel in enumerate(CHANNELS):
            columns = []
            for hat in held[:, used].T:
                error = np.zeros((len(hat), 3))
                error[:, c] = -hat
                columns.append(problem.nodes.column(error))
            names.append((name, channel))
            groups.append(np.stack(columns, axis=2))
            centres.append(where[used])
    scores = score_columns(fit, groups, believed)
    found = [
        _unknown(name, channel, where, score)
        for (name, channel), where, score in zip(names, centres, scores, strict=True)
        if score.separable and score.p < _LEVEL and score.held_out_nats > score.held_out_error
    ]
    found.sort(key=lambda u: u.nats - 0.5 * len(u.curve) * np.log(len(problem.nodes)), reverse=True)
    laws = [plainest_law(fit, believed, u.driver, u.channel) for u in found[:_WRITTEN]]
    written = [replace(u, expression=law or u.expression) for u, law in zip(found, laws, strict=False)]
    return [*written, *found[_WRITTEN:]]


def _unknown(name: str, channel: str, where: Array, score: ColumnScore) -> Unknown:
    return Unknown(
        channel=channel,
        driver=name,
        centres=where,
        curve=score.estimate,
        curve_error=score.standard_error,
        p=score.p,
        nats=0.5 * score.statistic / score.inflation,
        expression=_expression(name, channel, where, score),
    )


def _drivers(fit: Fit) -> dict[str, Callable[[Motion], tuple[Array, Array]]]:
    """Return for each driver a function to its hats (n, m) and their centres."""
    motions = fit.problem.motions
    of: dict[str, Callable[[Motion], Array]] = {
        "speed": lambda m: m.v,
        "yaw_rate": lambda m: m.omega,
        "acceleration": lambda m: m.a,
        "yaw_acceleration": lambda m: m.alpha,
        "time": lambda m: m.t_s,
        "distance": lambda m: m.distance,
    }
    drivers: dict[str, Callable[[Motion], tuple[Array, Array]]] = {}
    for name, value in of.items():
        moving = np.concatenate([value(m)[np.hypot(m.v, m.vy) > 0.02] for m in motions])
        if len(moving) < 100:
            continue
        knots = np.unique(np.quantile(moving, np.linspace(0.02, 0.98, _HATS[name])))
        if len(knots) > 2:
            drivers[name] = _hats(value, knots)
    drivers["heading"] = _harmonics
    xs, ys = (_spread(np.concatenate(axis)) for axis in ([m.x for m in motions], [m.y for m in motions]))
    drivers["position"] = _tiles(xs, ys)
    return drivers


def _spread(values: Array) -> Array:
    """Return grid lines that span nearly all of the values."""
    low, high = np.quantile(values, 0.02), np.quantile(values, 0.98)
    return np.linspace(float(low), float(high), _GRID)


def _hats(value: Callable[[Motion], Array], knots: Array) -> Callable[[Motion], tuple[Array, Array]]:
    def shape(motion: Motion) -> tuple[Array, Array]:
        return _linear_hats(value(motion), knots), knots

    return shape


def _linear_hats(values: Array, knots: Array) -> Array:
    """Return piecewise linear hats (n, m) that sum to one, flat beyond the outer knots."""
    clipped = np.clip(values, knots[0], knots[-1])
    return np.stack([np.interp(clipped, knots, unit) for unit in np.eye(len(knots))], axis=1)


def _harmonics(motion: Motion) -> tuple[Array, Array]:
    """Return cosines and sines of the heading and of twice the heading (n, 4), and their numbers."""
    angles = np.stack([np.cos(motion.theta), np.sin(motion.theta), np.cos(2 * motion.theta), np.sin(2 * motion.theta)])
    return angles.T, np.arange(4.0)


def _tiles(xs: Array, ys: Array) -> Callable[[Motion], tuple[Array, Array]]:
    places = np.array([(x, y) for x in xs for y in ys])

    def shape(motion: Motion) -> tuple[Array, Array]:
        across, up = _linear_hats(motion.x, xs), _linear_hats(motion.y, ys)
        return (across[:, :, None] * up[:, None, :]).reshape(len(motion), -1), places

    return shape


def _expression(name: str, channel: str, where: Array, score: ColumnScore) -> str:
    """Return the simplest effect of the shape of the curve, as an expression with its numbers filled in."""
    curve, weight = score.estimate, 1.0 / np.maximum(score.standard_error, 1e-12) ** 2
    if name == "heading":
        cos1, sin1, cos2, sin2 = curve
        first = f"{cos1:.3g} * cos(theta) + {sin1:.3g} * sin(theta)"
        second = f"{cos2:.3g} * cos(2 * theta) + {sin2:.3g} * sin(2 * theta)"
        keep_first = np.hypot(cos1, sin1) >= np.hypot(cos2, sin2)
        return f"{channel} += abs(v) * ({first if keep_first else second})"
    if name == "position":
        worst = int(np.argmax(np.abs(curve) * np.sqrt(weight)))
        x, y = where[worst]
        return f"{channel} += {curve[worst]:.3g} * abs(v) * exp(-((x - {x:.3g})**2 + (y - {y:.3g})**2) / 2)"
    variable = {"speed": "v", "yaw_rate": "omega", "acceleration": "a", "yaw_acceleration": "alpha", "time": "t"}
    slope, offset = np.polyfit(where, curve, 1, w=np.sqrt(weight))
    return f"{channel} += abs(v) * ({offset:.3g} + {slope:.3g} * {variable.get(name, name)})"

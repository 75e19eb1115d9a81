"""Curves of an error over one regressor: piecewise linear hats, harmonics of the heading, tiles of the floor."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.terms.basis import spread

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.geometry.se2 import Array

_GRID = 4  # grid lines of the floor along each axis
_FINEST = 0.05
"""Least distance of hats, as a fraction of the regressor's range: noise of the odometry enters regressor and error."""


def curve_regressors(
    motions: Sequence[Motion], *, placed: bool = True, sideways: bool = False
) -> dict[str, Callable[[Motion], tuple[Array, Array]]]:
    """Return for each regressor a function from a motion to the hats (n, m) and their centres.

    placed : whether the motions are in one frame, so that heading and position are regressors
    sideways : whether the robot drives sideways, so that this speed is a regressor
    """
    of: dict[str, tuple[int, Callable[[Motion], Array]]] = {  # number of hats, and the values
        "speed": (6, lambda m: m.v),
        "yaw_rate": (6, lambda m: m.omega),
        "acceleration": (6, lambda m: m.a),
        "lateral_acceleration": (6, lambda m: np.abs(m.v * m.omega)),
        "yaw_acceleration": (6, lambda m: m.alpha),
        "time": (8, lambda m: m.t_s),
        "distance": (8, lambda m: m.distance),
    }
    if sideways:
        of["sideways_speed"] = (6, lambda m: m.vy)
    regressors: dict[str, Callable[[Motion], tuple[Array, Array]]] = {}
    for name, (hats, value) in of.items():
        moving = np.concatenate([value(m)[m.speed > 0.02] for m in motions])
        if len(moving) < 100:
            continue
        knots = _apart(np.quantile(moving, np.linspace(0.02, 0.98, hats)))
        if len(knots) > 2:
            regressors[name] = lambda m, v=value, k=knots: (_linear_hats(v(m), k), k)  # type: ignore[misc]
    if not placed:
        return regressors
    regressors["heading"] = _harmonics
    xs, ys = (spread(np.concatenate([getattr(m, k) for m in motions]), (0.02, 0.98), _GRID) for k in "xy")
    regressors["position"] = _tiles(xs, ys)
    return regressors


def _apart(knots: Array) -> Array:
    """Return ascending knots without those too close to the previous one."""
    least, kept = _FINEST * (knots[-1] - knots[0]), [knots[0]]
    for knot in knots[1:]:
        if knot - kept[-1] > least:
            kept.append(knot)
    return np.array(kept)


def _linear_hats(values: Array, knots: Array) -> Array:
    """Return piecewise linear hats (n, m) with sum one, constant beyond the outer knots."""
    clipped = np.clip(values, knots[0], knots[-1])
    return np.stack([np.interp(clipped, knots, unit) for unit in np.eye(len(knots))]).T


def _harmonics(motion: Motion) -> tuple[Array, Array]:
    """Return cosines and sines of the heading and of twice the heading (n, 4), and their indices."""
    angles = np.stack([np.cos(motion.theta), np.sin(motion.theta), np.cos(2 * motion.theta), np.sin(2 * motion.theta)])
    return angles.T, np.arange(4.0)


def _tiles(xs: Array, ys: Array) -> Callable[[Motion], tuple[Array, Array]]:
    places = np.array([(x, y) for x in xs for y in ys])

    def shape(motion: Motion) -> tuple[Array, Array]:
        across, up = _linear_hats(motion.x, xs), _linear_hats(motion.y, ys)
        return (across[:, :, None] * up[:, None, :]).reshape(len(motion), -1), places

    return shape

"""How likely an end pose is, given where the robot was and what odometry says: p(x_t | u_t, x_t-1).

Two readings of Probabilistic Robotics (Thrun, Burgard & Fox 2005), section 5.4, table 5.5, and of the lecture:

* `product`: p1 p2 p3, the densities of the errors of rot1, trans and rot2 that lead to the pose. A particle filter may
  weigh poses by it; it is no density over x, y, theta, for its integral is not one.
* `pose_density`: the same over poses. Turn, drive, turn are polar coordinates, so the product is divided by |trans|;
  a pose is reached driving forwards or backwards and with whole turns more or less, so these are summed. It
  integrates to one and is what the samples of `samples.move_sampled` follow.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import ModelError
from odomcorrupt.geometry.se2 import rotate, wrap
from odomcorrupt.sampling.samples import move_between, move_variances

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import Noise
    from odomcorrupt.model.noise_laws import Variances
    from odomcorrupt.sampling.samples import Move

__all__ = ["DensityGrid", "density_on_grid", "pose_density", "product", "table_5_5"]

TURNS = 2.0 * np.pi * np.array([-1.0, 0.0, 1.0])
"""A heading's error is known up to whole turns; two of them away there is nothing left of any sensible noise."""


@dataclass(frozen=True, slots=True)
class _Errors:
    """Errors (n,) of rot1, trans and rot2 that lead to poses by driving one way, and the travel itself."""

    rot1: Array
    trans: Array
    rot2: Array
    travel_m: Array
    swing: float


def product(xyt: Array, move: Move, variances: Variances) -> Array:
    """Return p1 p2 p3 at end poses (n, 3), in 1/(m rad^2), variances being those of the odometry's motion."""
    errors, _ = _both_ways(xyt, move)
    return _factors(errors, _checked(variances))


def table_5_5(xyt: Array, move: Move, noise: Noise) -> Array:
    """Return p1 p2 p3 with the variances of each hypothetical motion, as table 5.5 of the book prints it.

    Slow: the law is asked at every pose of xyt (n, 3).
    """
    out = np.zeros(len(xyt))
    for i, pose in enumerate(xyt):
        hypothesis = move_between(move.start_xyt, pose, arc=move.swing < 1.0)
        out[i] = product(pose[None], move, move_variances(noise, hypothesis))[0]
    return out


def pose_density(xyt: Array, move: Move, variances: Variances) -> Array:
    """Return the density of end poses (n, 3) over x, y and theta, in 1/(m^2 rad)."""
    checked = _checked(variances)
    total = np.zeros(len(xyt))
    for errors in _both_ways(xyt, move):
        total += _factors(errors, checked) / np.maximum(np.abs(errors.travel_m), 1e-12) / move.swing
    return total


@dataclass(frozen=True, slots=True)
class DensityGrid:
    """A density over x and y, whatever the heading.

    x_m, y_m : (nx,), (ny,) positions
    density : (ny, nx), in 1/m^2 for `pose_density`
    """

    x_m: Array
    y_m: Array
    density: Array

    @property
    def integral(self) -> float:
        """The integral over the grid: one for a density whose grid is fine and wide enough."""
        cell = float((self.x_m[1] - self.x_m[0]) * (self.y_m[1] - self.y_m[0]))
        return float(self.density.sum()) * cell


def density_on_grid(move: Move, variances: Variances, *, reading: str = "pose", cells: int = 160) -> DensityGrid:
    """Return a density on a grid of end positions that holds all but a millionth of it, the heading summed up.

    reading : "pose" or "product"
    """
    v = _checked(variances)
    reach = 5.0
    trans_sd, rot1_sd = float(np.sqrt(v[1])), move.swing * float(np.sqrt(v[0]))
    # the corners of a fan: travel and bearing within so many deviations
    bearings = np.linspace(-min(reach * rot1_sd, np.pi), min(reach * rot1_sd, np.pi), 181)
    fan = np.concatenate(
        [rotate(move.shift_xy + e * move.along_xy, bearings) for e in (-reach * trans_sd, 0.0, reach * trans_sd)]
    )
    low, high = fan.min(axis=0) + move.start_xyt[:2], fan.max(axis=0) + move.start_xyt[:2]
    step = float((high - low).max()) / cells
    counts = np.maximum(np.ceil((high - low) / step).astype(int), 8)
    x, y = (low[i] + step * (0.5 + np.arange(counts[i])) for i in (0, 1))
    gx, gy = np.meshgrid(x, y)
    # the heading's error is rot1's, fixed by the position, plus rot2's: half its deviation is a fine enough step
    spread = np.sqrt(v[0] + v[2])
    half = min(6.0 * float(spread), np.pi)
    nodes = int(np.clip(np.ceil(4.0 * half / np.sqrt(v[2])), 9, 721))
    step_rad = 2.0 * half / nodes
    density = np.zeros(gx.size)
    evaluate = pose_density if reading == "pose" else product
    for error in -half + step_rad * (0.5 + np.arange(nodes)):
        heading = np.full(gx.size, move.start_xyt[2] + move.turn_rad + error)
        density += step_rad * evaluate(np.column_stack((gx.ravel(), gy.ravel(), heading)), move, variances)
    return DensityGrid(x, y, density.reshape(gx.shape))


def _both_ways(xyt: Array, move: Move) -> tuple[_Errors, _Errors]:
    """Return what must have gone wrong to end at poses (n, 3): driving the way odometry did, and the other way.

    Noise of trans acts along one axis, so the part of the motion across it is the same whatever the noise; what lies
    nearer to the start than that cannot be reached, and has an error of trans that is not a number.
    """
    planned = float(move.shift_xy @ move.along_xy)
    across2 = max(float(move.shift_xy @ move.shift_xy) - planned**2, 0.0)
    offset = xyt[:, :2] - move.start_xyt[:2]
    along2 = (offset**2).sum(axis=1) - across2
    # rounding alone must not make the start itself unreachable
    along = np.sqrt(np.where(along2 < -1e-12, np.nan, np.maximum(along2, 0.0)))
    sign = -1.0 if planned < 0.0 else 1.0
    ways = []
    for travel in (sign * along, -sign * along):
        error = travel - planned
        reached = move.shift_xy + error[:, None] * move.along_xy
        turned = wrap(np.arctan2(offset[:, 1], offset[:, 0]) - np.arctan2(reached[:, 1], reached[:, 0]))
        rot1 = turned / move.swing
        rot2 = wrap(xyt[:, 2] - move.start_xyt[2] - move.turn_rad - rot1)
        ways.append(_Errors(rot1, error, rot2, travel, move.swing))
    return ways[0], ways[1]


def _factors(errors: _Errors, variances: Array) -> Array:
    density = _normal(errors.trans, variances[1])
    for angle, variance, turns in (
        (errors.rot1, variances[0], TURNS / errors.swing),
        (errors.rot2, variances[2], TURNS),
    ):
        density = density * _normal(angle[:, None] + turns, variance).sum(axis=1)
    return np.nan_to_num(density)


def _normal(x: Array, variance: float) -> Array:
    out: Array = np.exp(-0.5 * x**2 / variance) / np.sqrt(2.0 * np.pi * variance)
    return out


def _checked(variances: Variances) -> Array:
    """Return the variances of rot1, trans and rot2 (3,); ModelError where they make no closed form."""
    v = np.concatenate((variances.rot1, variances.trans, variances.rot2))
    if variances.across[0] > 0.0:
        raise ModelError(f"density: across_trans gives {variances.across[0]:g} m^2; sideways noise has no closed form")
    if not (v > 0.0).all():
        names = [name for name, value in zip(("rot1", "trans", "rot2"), v, strict=True) if not value > 0.0]
        raise ModelError(f"density: no noise on {', '.join(names)}: such poses have no density; give every part noise")
    return v

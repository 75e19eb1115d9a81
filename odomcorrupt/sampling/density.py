"""How likely an end pose is, given where the robot was and what odometry says: p(x_t | u_t, x_t-1).

Three readings of Probabilistic Robotics (Thrun, Burgard & Fox 2005), section 5.4, table 5.5, and of the lecture:

* `pose_density`: a density over poses, and what the samples of `samples.move_sampled` follow. Turn, drive, turn are
  polar coordinates, so p1 p2 p3 is divided by |trans|; a pose is reached driving forwards or backwards and with whole
  turns more or less, so these are summed. It integrates to one.
* `product`: p1 p2 p3 alone, the densities of the errors of rot1, trans and rot2 that lead to the pose, their variances
  those of the odometry's motion. A particle filter may weigh poses by it; its integral is not one.
* `hypothetical`: the same with the variances of the motion to each pose, as the book prints table 5.5.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import MapError, ModelError
from odomcorrupt.geometry.increments import Increments
from odomcorrupt.geometry.se2 import rotate, wrap
from odomcorrupt.model.noise_laws import variances as variances_of
from odomcorrupt.sampling.samples import with_noise

if TYPE_CHECKING:
    from collections.abc import Callable

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.mapping.free_space import Check, FreeSpace
    from odomcorrupt.model.motion_model import Noise
    from odomcorrupt.model.noise_laws import Variances
    from odomcorrupt.sampling.samples import Move

__all__ = ["DensityGrid", "density_on_grid", "hypothetical", "pose_density", "product", "within_map"]

TURNS = 2.0 * np.pi * np.array([-1.0, 0.0, 1.0])
"""A heading's error is known up to whole turns; two of them away there is nothing left of any sensible noise."""


@dataclass(frozen=True, slots=True)
class _Errors:
    """Errors (n,) of rot1, trans and rot2 that lead to poses by driving one way, and the travel itself.

    chord_per_arc : (n,) how long the travel is, as part of the way driven; one where `arc` is not set
    """

    rot1: Array
    trans: Array
    rot2: Array
    travel_m: Array
    chord_per_arc: Array
    arc: bool


def product(xyt: Array, move: Move, variances: Variances) -> Array:
    """Return p1 p2 p3 at end poses (n, 3), in 1/(m rad^2), variances being those of the odometry's motion."""
    errors, *_ = _ways(xyt, move)
    return _factors(errors, _checked(variances))


def hypothetical(xyt: Array, move: Move, noise: Noise) -> Array:
    """Return p1 p2 p3 at end poses (n, 3) with the variances of the motion to each pose, in 1/(m rad^2).

    The book's own form (table 5.5, lines 7 to 11): alphas are applied to the hypothetical motion and not to odometry's.

    Raises
    ------
    ModelError
        Where the noise goes with a step of its own (`--step`), which a motion to a pose does not have.

    """
    if noise.step is not None:
        raise ModelError("hypothetical: this noise has a step of its own (--step); the book's table has none")
    offset = rotate(xyt[:, :2] - move.start_xyt[:2], -move.start_xyt[2])
    turn = wrap(xyt[:, 2] - move.start_xyt[2])
    # increments are seen from the heading after half the turn
    body = rotate(offset, -turn / 2.0)
    steps = Increments(np.ascontiguousarray(body[:, 0]), np.ascontiguousarray(body[:, 1]), turn)
    v = variances_of(noise.law, noise.coefficients, steps)
    if (v.across > 0.0).any():
        raise ModelError("density: sideways noise has no closed form; leave out across_trans")
    first, *_ = _ways(xyt, move)
    # a motion of nothing has no noise, and no other pose can be where it leads
    with np.errstate(divide="ignore", invalid="ignore"):
        return _factors(first, np.stack((v.rot1, v.trans, v.rot2)))


def pose_density(xyt: Array, move: Move, variances: Variances) -> Array:
    """Return the density of end poses (n, 3) over x, y and theta, in 1/(m^2 rad)."""
    checked = _checked(variances)
    total = np.zeros(len(xyt))
    for errors in _ways(xyt, move):
        stretch = np.abs(errors.travel_m * errors.chord_per_arc)
        total += np.nan_to_num(_factors(errors, checked) / np.maximum(stretch, 1e-12) / move.swing)
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


def density_on_grid(
    move: Move, variances: Variances, *, density_of: Callable[[Array], Array] | None = None, cells: int = 160
) -> DensityGrid:
    """Return a density on a grid of end positions that holds all but a millionth of it, the heading summed up.

    density_of : what is summed up at poses (n, 3); None is `pose_density`
    """
    evaluate = density_of or (lambda poses: pose_density(poses, move, variances))
    v = _checked(variances)
    reach = 5.0
    # the corners of a fan: travel and bearing within so many deviations
    turns = min(reach * float(np.sqrt(v[0])), np.pi / move.swing)
    errors = np.array([(turn, e * np.sqrt(v[1]), 0.0, 0.0) for turn in np.linspace(-turns, turns, 181)
                       for e in (-reach, -reach / 2.0, 0.0, reach / 2.0, reach)])  # fmt: skip
    fan = with_noise(move, errors)[:, :2]
    low, high = fan.min(axis=0), fan.max(axis=0)
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
    for error in -half + step_rad * (0.5 + np.arange(nodes)):
        heading = np.full(gx.size, move.start_xyt[2] + move.turn_rad + error)
        density += step_rad * evaluate(np.column_stack((gx.ravel(), gy.ravel(), heading)))
    return DensityGrid(x, y, density.reshape(gx.shape))


def within_map(grid: DensityGrid, space: FreeSpace, start_xy: Array, check: Check) -> tuple[DensityGrid, float]:
    """Return p(x_t | u_t, x_t-1, m) on a grid, and which part of the density without the map is free.

    The book's product of the motion's density and whether the pose is free (section 5.5), divided by its integral.

    Raises
    ------
    MapError
        Where no part of it is free.

    """
    gx, gy = np.meshgrid(grid.x_m, grid.y_m)
    ends = np.column_stack((gx.ravel(), gy.ravel()))
    free = space.allows(np.broadcast_to(start_xy, ends.shape), ends, check).reshape(gx.shape)
    part = float(grid.density[free].sum() / grid.density.sum())
    if not part > 0.0:
        raise MapError("the motion ends in a wall, and its noise does not lead out of it; check --map-pose")
    return replace(grid, density=np.where(free, grid.density, 0.0) / part), part


def _ways(xyt: Array, move: Move) -> list[_Errors]:
    """Return what must have gone wrong to end at poses (n, 3): driving the way odometry did, and the other way.

    Noise of trans acts along one axis, so the part of the motion across it is the same whatever the noise; what lies
    nearer to the start than that cannot be reached, and has an error of trans that is not a number. On an arc every
    whole turn of the chord is a way of its own, for an arc of the same chord that turns more is longer.
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
        reached = move.shift_xy + (travel - planned)[:, None] * move.along_xy
        turned = wrap(np.arctan2(offset[:, 1], offset[:, 0]) - np.arctan2(reached[:, 1], reached[:, 0]))
        for whole in (0.0, *TURNS[TURNS != 0.0]) if move.arc else (0.0,):
            rot1 = (turned + whole) / move.swing
            rot2 = wrap(xyt[:, 2] - move.start_xyt[2] - move.turn_rad - rot1)
            shorter = move.chord_per_arc(move.turn_rad + rot1)
            with np.errstate(divide="ignore", invalid="ignore"):
                error = travel / shorter - move.arc_m
            ways.append(_Errors(rot1, error, rot2, travel, shorter, arc=move.arc))
    return ways


def _factors(errors: _Errors, variances: Array) -> Array:
    """Return p1 p2 p3 (n,); variances (3,) or (3, n) of rot1, trans and rot2."""
    rot1, trans, rot2 = (np.atleast_1d(v) for v in variances)
    density = _normal(errors.trans, trans)
    # on an arc whole turns are ways of their own
    for angle, variance, turns in (
        (errors.rot1, rot1, TURNS[1:2] if errors.arc else TURNS),
        (errors.rot2, rot2, TURNS),
    ):
        density = density * _normal(angle[:, None] + turns, variance[:, None]).sum(axis=1)
    return np.nan_to_num(density)


def _normal(x: Array, variance: Array) -> Array:
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

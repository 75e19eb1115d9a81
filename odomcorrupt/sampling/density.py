"""Density of the end pose, given the start pose and the odometry: p(x_t | u_t, x_t-1).

Three variants of Probabilistic Robotics (Thrun, Burgard & Fox 2005), section 5.4, table 5.5, and of the lecture:

* `pose_density`: a density over poses, of which `samples.move_sampled` draws. Turn, drive, turn are polar coordinates,
  so p1 p2 p3 is divided by |trans|; a pose can be reached forwards or backwards and with additional whole turns, so
  these terms are summed. It integrates to one.
* `product`: p1 p2 p3, the densities of the errors of rot1, trans and rot2 that lead to the pose, with the variances of
  the odometry's motion. A particle filter may weight poses by it; its integral is not one.
* `hypothetical`: the same with the variances of the motion to each pose, as the book prints table 5.5.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import MapError, ModelError
from odomcorrupt.geometry.se2 import Increments, rotate, wrap
from odomcorrupt.model.noise_laws import variances as variances_of
from odomcorrupt.sampling.samples import Move, with_noise

if TYPE_CHECKING:
    from collections.abc import Callable

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.mapping.occupancy_grid import Constraint
    from odomcorrupt.model.motion_model import Noise
    from odomcorrupt.model.noise_laws import Variances

TURNS = 2.0 * np.pi * np.array([-1.0, 0.0, 1.0])
"""Whole turns summed over, because headings are known modulo 2 pi; at two turns, realistic noise has no density."""


@dataclass(frozen=True, slots=True)
class _Errors:
    """Errors (n,) of rot1, trans and rot2 that lead to poses in one driving direction, and the travel.

    chord_per_arc : (n,) ratio of the travel (chord) to the driven arc; one unless `arc` is set
    """

    rot1: Array
    trans: Array
    rot2: Array
    travel_m: Array
    chord_per_arc: Array
    arc: bool


def product(xyt: Array, move: Move, variances: Variances) -> Array:
    """Return p1 p2 p3 at end poses (n, 3), in 1/(m rad^2), with variances of the odometry's motion."""
    errors, *_ = _solutions(xyt, move)
    return _factors(errors, _checked(variances))


def hypothetical(xyt: Array, move: Move, noise: Noise) -> Array:
    """Return p1 p2 p3 at end poses (n, 3) with the variances of the motion to each pose, in 1/(m rad^2).

    The book's own form (table 5.5, lines 7 to 11): alphas apply to the hypothetical motion, not to the odometry's.

    Raises
    ------
    ModelError
        If the noise has a step (`--step`), which is undefined for a motion to a pose.
    """
    if noise.step is not None:
        raise ModelError("hypothetical: this noise has its own step (--step), which the book's table does not have")
    offset = rotate(xyt[:, :2] - move.start_xyt[:2], -move.start_xyt[2])
    turn = wrap(xyt[:, 2] - move.start_xyt[2])
    # increments are expressed at mid heading
    body = rotate(offset, -turn / 2.0)
    steps = Increments(np.ascontiguousarray(body[:, 0]), np.ascontiguousarray(body[:, 1]), turn)
    v = variances_of(noise.law, noise.coefficients, steps)
    if (v.across > 0.0).any():
        raise ModelError("density: sideways noise has no closed form; leave out across_trans")
    first, *_ = _solutions(xyt, move)
    # Zero motion has no noise, so every other pose has density zero.
    with np.errstate(divide="ignore", invalid="ignore"):
        return _factors(first, np.stack((v.rot1, v.trans, v.rot2)))


def pose_density(xyt: Array, move: Move, variances: Variances) -> Array:
    """Return the density of end poses (n, 3) over x, y and theta, in 1/(m^2 rad)."""
    checked = _checked(variances)
    total = np.zeros(len(xyt))
    for errors in _solutions(xyt, move):
        stretch = np.abs(errors.travel_m * errors.chord_per_arc)
        total += np.nan_to_num(_factors(errors, checked) / np.maximum(stretch, 1e-12) / move.swing)
    return total


@dataclass(frozen=True, slots=True)
class DensityGrid:
    """A density over x and y, integrated over the heading.

    x_m, y_m : (nx,), (ny,) positions
    density : (ny, nx), in 1/m^2 for `pose_density`
    """

    x_m: Array
    y_m: Array
    density: Array

    @property
    def integral(self) -> float:
        """Integral over the grid: one for a density on a sufficiently fine and wide grid."""
        cell = float((self.x_m[1] - self.x_m[0]) * (self.y_m[1] - self.y_m[0]))
        return float(self.density.sum()) * cell


def density_on_grid(
    move: Move, variances: Variances, *, density_of: Callable[[Array], Array] | None = None, cells: int = 160
) -> DensityGrid:
    """Return a density, integrated over the heading, on a grid that contains all but a millionth of it.

    density_of : density at poses (n, 3); None is `pose_density`
    """
    evaluate = density_of or (lambda poses: pose_density(poses, move, variances))
    v = _checked(variances)
    reach = 5.0
    # the corners of a fan: travel and bearing within `reach` standard deviations
    turns = min(reach * float(np.sqrt(v[0])), np.pi / move.swing)
    errors = np.array([(turn, e * np.sqrt(v[1]), 0.0, 0.0) for turn in np.linspace(-turns, turns, 181)
                       for e in (-reach, -reach / 2.0, 0.0, reach / 2.0, reach)])  # fmt: skip
    fan = with_noise(move, errors)[:, :2]
    low, high = fan.min(axis=0), fan.max(axis=0)
    step = float((high - low).max()) / cells
    counts = np.maximum(np.ceil((high - low) / step).astype(int), 8)
    x, y = (low[i] + step * (0.5 + np.arange(counts[i])) for i in (0, 1))
    gx, gy = np.meshgrid(x, y)
    # The heading error is rot1's, fixed by the position, plus rot2's; steps of half its deviation are fine enough.
    spread = np.sqrt(v[0] + v[2])
    half = min(6.0 * float(spread), np.pi)
    nodes = int(np.clip(np.ceil(4.0 * half / np.sqrt(v[2])), 9, 721))
    step_rad = 2.0 * half / nodes
    density = np.zeros(gx.size)
    for error in -half + step_rad * (0.5 + np.arange(nodes)):
        heading = np.full(gx.size, move.start_xyt[2] + move.turn_rad + error)
        density += step_rad * evaluate(np.column_stack((gx.ravel(), gy.ravel(), heading)))
    return DensityGrid(x, y, density.reshape(gx.shape))


def within_map(grid: DensityGrid, within: Constraint, start_xy: Array) -> tuple[DensityGrid, float]:
    """Return p(x_t | u_t, x_t-1, m) on a grid, and the fraction of the density without the map that is in free space.

    The book's product of the motion's density and whether the pose is free (section 5.5), divided by its integral.

    Raises
    ------
    MapError
        If no part of it is free.
    """
    gx, gy = np.meshgrid(grid.x_m, grid.y_m)
    ends = np.column_stack((gx.ravel(), gy.ravel()))
    free = within.allows(np.broadcast_to(start_xy, ends.shape), ends).reshape(gx.shape)
    part = float(grid.density[free].sum() / grid.density.sum())
    if not part > 0.0:
        raise MapError("the motion ends in a wall, and no noisy end pose leaves it; check --map-pose")
    return replace(grid, density=np.where(free, grid.density, 0.0) / part), part


def _solutions(xyt: Array, move: Move) -> list[_Errors]:
    """Return the errors that lead to poses (n, 3), for driving in the odometry's direction and in the opposite one.

    Noise of trans acts along one axis, so the motion's component across it is fixed; poses nearer to the start than
    that component are unreachable and have NaN as error of trans. On an arc, each whole turn of the chord is a separate
    case, because an arc with the same chord that turns more is longer.
    """
    planned = float(move.shift_xy @ move.along_xy)
    across2 = max(float(move.shift_xy @ move.shift_xy) - planned**2, 0.0)
    offset = xyt[:, :2] - move.start_xyt[:2]
    along2 = (offset**2).sum(axis=1) - across2
    # Rounding must not make the start itself unreachable.
    along = np.sqrt(np.where(along2 < -1e-12, np.nan, np.maximum(along2, 0.0)))
    sign = -1.0 if planned < 0.0 else 1.0
    solutions = []
    for travel in (sign * along, -sign * along):
        reached = move.shift_xy + (travel - planned)[:, None] * move.along_xy
        turned = wrap(np.arctan2(offset[:, 1], offset[:, 0]) - np.arctan2(reached[:, 1], reached[:, 0]))
        for whole in (0.0, *TURNS[TURNS != 0.0]) if move.arc else (0.0,):
            rot1 = (turned + whole) / move.swing
            rot2 = wrap(xyt[:, 2] - move.start_xyt[2] - move.turn_rad - rot1)
            shorter = move.chord_per_arc(move.turn_rad + rot1)
            with np.errstate(divide="ignore", invalid="ignore"):
                error = travel / shorter - move.arc_m
            solutions.append(_Errors(rot1, error, rot2, travel, shorter, arc=move.arc))
    return solutions


def _factors(errors: _Errors, variances: Array) -> Array:
    """Return p1 p2 p3 (n,); variances (3,) or (3, n) of rot1, trans and rot2."""
    rot1, trans, rot2 = (np.atleast_1d(v) for v in variances)
    density = _normal(errors.trans, trans)
    # on an arc, whole turns are separate cases
    for angle, variance, turns in (
        (errors.rot1, rot1, TURNS[1:2] if errors.arc else TURNS),
        (errors.rot2, rot2, TURNS),
    ):
        density = density * _normal(angle[:, None] + turns, variance[:, None]).sum(axis=1)
    return np.nan_to_num(density)


def _normal(x: Array, variance: Array) -> Array:
    return np.exp(-0.5 * x**2 / variance) / np.sqrt(2.0 * np.pi * variance)


def _checked(variances: Variances) -> Array:
    """Return the variances of rot1, trans and rot2 (3,); ModelError if there is no closed form."""
    v = np.concatenate((variances.rot1, variances.trans, variances.rot2))
    if variances.across[0] > 0.0:
        raise ModelError(f"density: across_trans gives {variances.across[0]:g} m^2; sideways noise has no closed form")
    if not (v > 0.0).all():
        names = [name for name, value in zip(("rot1", "trans", "rot2"), v, strict=True) if not value > 0.0]
        raise ModelError(f"density: no noise on {', '.join(names)}: such poses have no density; give every part noise")
    return v

"""Free space of a robot in a map: positions clear of walls by its radius, and straight paths between them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from odomcorrupt.errors import MapError
from odomcorrupt.geometry.se2 import rotate
from odomcorrupt.mapping.occupancy_grid import OCCUPIED, UNKNOWN, Grid, traverse

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

_MOST_WORK = 2e9
"""Largest product of the cells of a map and the robot's radius in cells: ten seconds."""

Unknown = Literal["blocked", "free"]
Check = Literal["endpoint", "path"]


@dataclass(frozen=True, slots=True)
class FreeSpace:
    """Map inflated for a robot.

    blocked : (rows, columns) 1 in cells where the robot's centre cannot be
    map_from_odom : (3,) pose of the odom frame in the map; positions are given in the odom frame
    outside : 1 if positions beyond the map's border count as blocked
    """

    grid: Grid
    blocked: NDArray[np.uint8]
    map_from_odom: Array
    outside: int

    def free(self, xy: Array) -> NDArray[np.bool_]:
        """Return whether the robot can be at positions (n, 2) in the odom frame."""
        return self.grid.look_up(self.blocked, self._in_map(xy), self.outside) == 0

    def reachable(self, from_xy: Array, to_xy: Array) -> NDArray[np.bool_]:
        """Return whether the straight path to each position (n, 2) is free, both ends included.

        The lecture's star: a position behind a wall is free, but not reachable.
        """
        rows, columns = self.blocked.shape
        clear = self.free(to_xy)
        # a path to a blocked end need not be checked
        left = np.flatnonzero(clear)
        start, end = (self.grid.places(self._in_map(xy[left])) for xy in (from_xy, to_xy))
        for number, cell in traverse(start, end):
            inside = (cell >= 0).all(axis=1) & (cell[:, 0] < columns) & (cell[:, 1] < rows)
            column, row = np.where(inside[:, None], cell, 0).T
            stopped = np.where(inside, self.blocked[row, column], self.outside) != 0
            clear[left[number[stopped]]] = False
        return clear

    def _in_map(self, xy: Array) -> Array:
        turn = np.full(xy.shape[:-1], self.map_from_odom[2])
        return rotate(xy, turn) + self.map_from_odom[:2]


@dataclass(frozen=True, slots=True)
class Constraint:
    """Constraint of motions to free space: the space, the part of a motion that is checked, and the number of tries."""

    space: FreeSpace
    check: Check = "endpoint"
    tries: int = 100

    def allows(self, from_xy: Array, to_xy: Array) -> NDArray[np.bool_]:
        """Return whether motions (n,) between positions (n, 2) are free."""
        return self.space.free(to_xy) if self.check == "endpoint" else self.space.reachable(from_xy, to_xy)


def free_space(
    grid: Grid, radius_m: float, *, unknown: Unknown = "blocked", map_from_odom: Array | None = None
) -> FreeSpace:
    """Prepare a map for a round robot.

    grid : occupancy grid
    radius_m : radius of the robot. A cell is blocked if a wall is nearer than this to its centre, accurate
        to half a cell's diagonal
    unknown : whether the robot's centre may be in an unknown cell, or beyond the map. Only walls are inflated by the
        radius; unknown cells are not
    map_from_odom : pose of the odom frame in the map; by default the same frame
    """
    if not (np.isfinite(radius_m) and radius_m >= 0.0):
        raise MapError(f"robot radius: {radius_m} m; it must be zero or more")
    if radius_m / grid.resolution_m * grid.cells.size > _MOST_WORK:
        raise MapError(
            f"map: {grid.cells.size:,} cells of {grid.resolution_m:g} m, and a robot of {radius_m:g} m; that takes "
            "minutes: give a coarser map, or a smaller --robot-radius"
        )
    # a radius of three and a half cells must not be reduced by rounding
    blocked = _inflated(grid.cells == OCCUPIED, radius_m / grid.resolution_m * (1.0 + 1e-9))
    if unknown == "blocked":
        blocked |= grid.cells == UNKNOWN
    pose = np.zeros(3) if map_from_odom is None else map_from_odom
    return FreeSpace(grid, blocked.astype(np.uint8), pose, int(unknown == "blocked"))


def _inflated(walls: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """Return the cells with a centre within the radius, in cells, of a wall's square.

    A disc is a stack of rows. Each row's range is looked up in cumulative sums, so the cost grows with the radius
    instead of its square.
    """
    rows, columns = walls.shape
    reach = int(np.floor(radius + 0.5))
    # cumulative sums along each row, continued by its ends as far as a disc reaches
    beyond = min(reach, columns)
    total = np.zeros((rows, columns + 1 + 2 * beyond), dtype=np.int32)
    np.cumsum(walls, axis=1, out=total[:, beyond + 1 : beyond + 1 + columns])
    total[:, beyond + 1 + columns :] = total[:, beyond + columns, None]
    out = np.zeros_like(walls)
    for down in range(min(reach, rows - 1) + 1):
        gap = max(down - 0.5, 0.0)
        if gap > radius:
            break
        # even a zero radius keeps the robot's centre out of the wall cell
        run = min(int(np.floor(np.sqrt(radius**2 - gap**2) + 0.5)), columns) if radius > 0.0 else 0
        near = total[:, beyond + run + 1 :][:, :columns] > total[:, beyond - run :][:, :columns]
        out[down:] |= near[: rows - down]
        out[: rows - down] |= near[down:]
    return out

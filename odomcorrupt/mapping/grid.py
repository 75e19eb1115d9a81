"""A map of free, occupied and unknown cells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import rotate

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

__all__ = ["FREE", "OCCUPIED", "UNKNOWN", "Grid"]

FREE, OCCUPIED, UNKNOWN = 0, 1, 2


@dataclass(frozen=True, slots=True)
class Grid:
    """Cells of a plane.

    cells : (rows, columns) uint8 of FREE, OCCUPIED or UNKNOWN; rows go along the grid's y axis
    resolution_m : side of a cell
    origin_xyt : (3,) the outer corner of cell (0, 0), and where the grid's x axis points
    """

    cells: NDArray[np.uint8]
    resolution_m: float
    origin_xyt: Array

    def places(self, xy: Array) -> Array:
        """Return positions (..., 2) in metres as column and row (..., 2) in cells, not rounded."""
        out: Array = rotate(xy - self.origin_xyt[:2], -np.full(xy.shape[:-1], self.origin_xyt[2])) / self.resolution_m
        return out

    def states(self, xy: Array) -> NDArray[np.uint8]:
        """Return the state of the cells that positions (n, 2) lie in; UNKNOWN outside the map."""
        return self.look_up(self.cells, xy, UNKNOWN)

    def look_up(self, layer: NDArray[np.uint8], xy: Array, outside: int) -> NDArray[np.uint8]:
        """Return the entries of a layer (rows, columns) at positions (n, 2)."""
        rows, columns = layer.shape
        place = np.floor(self.places(xy))
        # what is not finite lies outside too
        x, y = place[..., 0], place[..., 1]
        inside = (x >= 0.0) & (x < columns) & (y >= 0.0) & (y < rows)
        column, row = (np.where(inside, part, 0.0).astype(np.int64) for part in (x, y))
        return np.where(inside, layer[row, column], np.uint8(outside))

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top in metres, of a map whose axes are not turned."""
        rows, columns = self.cells.shape
        x, y = self.origin_xyt[:2]
        return float(x), float(x + columns * self.resolution_m), float(y), float(y + rows * self.resolution_m)

"""Ray casting: cells that straight lines cross, for many lines at once, and maps from laser rays.

Traversal follows Amanatides & Woo, "A fast voxel traversal algorithm for ray tracing", Eurographics 1987: every
cell on a line, once each. A map counts for each cell the rays that ended in it and those that passed through.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.mapping.mapfile import FREE, OCCUPIED, UNKNOWN, Grid

if TYPE_CHECKING:
    from collections.abc import Iterator

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

MAX_CELLS = 50_000_000
"""Largest number of cells of a map; more indicate an error: a drift of kilometres or a resolution of millimetres."""

OCCUPIED_SHARE = 0.25
"""Smallest share of the rays reaching a cell that end in it, for the cell to be a wall (gmapping's occ_thresh)."""

_RAYS_AT_ONCE = 1 << 15


@dataclass(frozen=True, slots=True)
class Canvas:
    """An empty map: lower left corner (2,) in metres, side of a cell, rows and columns."""

    low_xy: Array
    resolution_m: float
    shape: tuple[int, int]


def canvas_for(points_xy: Array, resolution_m: float) -> Canvas:
    """Return the smallest canvas of whole cells that holds points (n, 2) with a margin of half a metre."""
    low = np.floor((points_xy.min(axis=0) - 0.5) / resolution_m) * resolution_m
    columns, rows = np.ceil((points_xy.max(axis=0) + 0.5 - low) / resolution_m)
    if not rows * columns <= MAX_CELLS:
        raise RecordingError(
            f"map: {rows * columns:.3g} cells of {resolution_m:g} m; a coarser --resolution or less noise makes fewer"
        )
    return Canvas(low, resolution_m, (int(rows), int(columns)))


def traverse(start: Array, end: Array) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Yield, step by step, the cells on lines from start to end (n, 2), in cells.

    Each step gives the indices (m,) of the lines that have not reached their end, and their cells (m, 2) as column and
    row; the end cell itself is not given.
    """
    cell, last = np.floor(start).astype(np.int64), np.floor(end).astype(np.int64)
    direction = end - start
    way = np.sign(direction).astype(np.int64)
    with np.errstate(divide="ignore", invalid="ignore"):
        stride = np.abs(1.0 / direction)
        # distance to the next border of a column or row, as a fraction of the line
        border = np.where(way > 0, cell + 1.0 - start, start - cell) * stride
    border, stride = np.where(way == 0, np.inf, border), np.where(way == 0, np.inf, stride)
    left = np.abs(last - cell).sum(axis=1)
    number = np.arange(len(start))
    while (going := left > 0).any():
        if not going.all():
            number, left, cell, way = number[going], left[going], cell[going], way[going]
            border, stride, last = border[going], stride[going], last[going]
        yield number, cell
        # rounding must not move a line past its last column or row
        border = np.where(cell == last, np.inf, border)
        axis = np.argmin(border, axis=1)
        row = np.arange(len(axis))
        cell = cell.copy()
        cell[row, axis] += way[row, axis]
        border[row, axis] += stride[row, axis]
        left = left - 1


def draw_map(canvas: Canvas, from_xy: Array, to_xy: Array) -> Grid:
    """Return the map of n rays (n, 2) from laser positions to hits, metres in the map's frame."""
    rows, columns = canvas.shape
    passed, hit = np.zeros(rows * columns, dtype=np.int64), np.zeros(rows * columns, dtype=np.int64)
    start, end = ((xy - canvas.low_xy) / canvas.resolution_m for xy in (from_xy, to_xy))
    inside = ((start >= 0.0) & (start < (columns, rows)) & (end >= 0.0) & (end < (columns, rows))).all(axis=1)
    start_cell, end_cell = np.floor(start[inside]).astype(np.int64), np.floor(end[inside]).astype(np.int64)
    # a laser is finer than the cells: rays between the same two cells are traversed once, from centre to centre
    flat_end = end_cell[:, 1] * columns + end_cell[:, 0]
    key = (start_cell[:, 1] * columns + start_cell[:, 0]) * (rows * columns) + flat_end
    _, first, weight = np.unique(key, return_index=True, return_counts=True)
    for i in range(0, len(first), _RAYS_AT_ONCE):
        part = slice(i, i + _RAYS_AT_ONCE)
        begin, finish = ((cells[first[part]] + 0.5).astype(np.float64) for cells in (start_cell, end_cell))
        for number, cell in traverse(begin, finish):
            np.add.at(passed, cell[:, 1] * columns + cell[:, 0], weight[part][number])
    np.add.at(hit, flat_end, 1)
    share = hit / np.maximum(hit + passed, 1)
    cells = np.where(share >= OCCUPIED_SHARE, OCCUPIED, FREE)
    cells = np.where(hit + passed == 0, UNKNOWN, cells).astype(np.uint8)
    return Grid(cells.reshape(rows, columns), canvas.resolution_m, np.array([*canvas.low_xy, 0.0]))

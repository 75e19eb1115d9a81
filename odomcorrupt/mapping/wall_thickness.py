"""Wall thickness of a map: the mean plane variance, in two dimensions.

Razlaw, Droeschel, Holz & Behnke, "Evaluation of registration methods for sparse 3D laser scans" (ECMR 2015), evaluate
a map without truth by the variance of its points about the plane through their neighbours: the smallest eigenvalue of
the covariance of all points near a point, averaged over points. Here planes are lines, neighbours are those in a
square of `WINDOW_M`, and the root is reported: a deviation in metres. Corners are not lines, but count equally in
every map, so the difference between two maps of one drive measures the effect of the odometry.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

__all__ = ["WINDOW_M", "added_thickness", "distance_to_surface", "wall_thickness"]

WINDOW_M = 1.0
"""Side of the square of neighbours, metres; walls more than half of it apart are separate walls."""

MIN_NEIGHBOURS = 8

_CELL_M = 0.02
"""Side of the cells into which points are binned, metres."""

_FLAT = 0.1
"""Ratio of the smaller to the larger variance above which points are not a wall and have no normal."""


def added_thickness(clean_m: Array, noisy_m: Array) -> Array:
    """Return the increase of wall thickness by noise (k,), metres, as the root of the difference of the variances."""
    out: Array = np.sqrt(np.maximum(noisy_m**2 - clean_m**2, 0.0))
    return out


def wall_thickness(points_xy: Array, *, cell_m: float = _CELL_M) -> float:
    """Return the root of the mean plane variance of points (n, 2), metres; nan if no point has neighbours.

    Points are binned into cells of `cell_m` and keep their own coordinates in the sums; the window is that of the
    cell, so its edge is rounded to a cell.
    """
    xx, xy, yy = _covariances(points_xy, cell_m)
    smaller = _smaller(xx, xy, yy)
    known = np.isfinite(smaller)
    return float(np.sqrt(np.maximum(smaller[known], 0.0).mean())) if known.any() else float("nan")


def distance_to_surface(clean_xy: Array, noisy_xy: Array) -> Array:
    """Return the distance of noisy hits from the walls of the clean map (n,), metres; nan for clean hits on no wall.

    The displacement of a hit is measured across the wall of its clean counterpart: shifts along a wall are not visible
    in a map, and a wall displaced by more than the window is still compared with itself.

    clean_xy, noisy_xy : (n, 2) ends of the same rays, transformed by clean and by noisy odometry, metres
    """
    xx, xy, yy = _covariances(clean_xy, _CELL_M)
    smaller = np.maximum(_smaller(xx, xy, yy), 0.0)
    along = 0.5 * np.arctan2(2.0 * xy, xx - yy)
    shift = noisy_xy - clean_xy
    across = np.abs(-np.sin(along) * shift[:, 0] + np.cos(along) * shift[:, 1])
    out: Array = np.where(smaller < _FLAT * (xx + yy - smaller), across, np.nan)
    return out


def _smaller(xx: Array, xy: Array, yy: Array) -> Array:
    """Return the smaller eigenvalue (n,) of covariances."""
    out: Array = (xx + yy) / 2.0 - np.sqrt(((xx - yy) / 2.0) ** 2 + xy**2)
    return out


def _covariances(points_xy: Array, cell_m: float) -> tuple[Array, Array, Array]:
    """Return xx, xy and yy (n,) of the points in the window around each point; nan if there are too few."""
    low = points_xy.min(axis=0) - 2.0 * cell_m
    # centred coordinates, because the covariance is a small difference of large sums
    centred = points_xy - points_xy.mean(axis=0)
    column, row = np.floor((points_xy - low) / cell_m).astype(np.int64).T
    shape = int(row.max()) + 2, int(column.max()) + 2
    flat = row * shape[1] + column
    half = round(0.5 * WINDOW_M / cell_m)
    x, y = centred.T
    window = _Windows(row, column, shape, half)
    count, sx, sy, sxx, sxy, syy = (window.sums(flat, w) for w in (None, x, y, x * x, x * y, y * y))
    n = np.where(count >= MIN_NEIGHBOURS, count, np.nan)
    xx, xy, yy = (s / n - (a / n) * (b / n) for s, a, b in ((sxx, sx, sx), (sxy, sx, sy), (syy, sy, sy)))
    return xx, xy, yy


class _Windows:
    """Sums over the square window around each point, by cumulative sums over cells in both directions."""

    def __init__(self, row: NDArray[np.int64], column: NDArray[np.int64], shape: tuple[int, int], half: int) -> None:
        self._shape = shape
        self._top = np.minimum(row + half + 1, shape[0])
        self._bottom = np.maximum(row - half, 0)
        self._right = np.minimum(column + half + 1, shape[1])
        self._left = np.maximum(column - half, 0)

    def sums(self, flat: NDArray[np.int64], weights: Array | None) -> Array:
        """Return the sums (n,) of weights (n,), or of ones."""
        cells = np.bincount(flat, weights, minlength=self._shape[0] * self._shape[1]).reshape(self._shape)
        table = np.zeros((self._shape[0] + 1, self._shape[1] + 1))
        np.cumsum(np.cumsum(cells, axis=0), axis=1, out=table[1:, 1:])
        out: Array = (
            table[self._top, self._right]
            - table[self._bottom, self._right]
            - table[self._top, self._left]
            + table[self._bottom, self._left]
        )
        return out

"""Which way the surfaces face that a sweep met: lines through the neighbours of each return."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

__all__ = ["normals"]

_REACH_M = 0.3
"""Neighbours of a return lie at most this far away."""
_MOST_STEPS = 6
_LEAST = 3
_FLAT = 0.3
"""Deviation across a line over that along it, above which the neighbours are no line."""


def normals(xy: Array) -> tuple[Array, NDArray[np.bool_]]:
    """Return unit normals (m, 2) of the surfaces at returns (m, 2) in the order of bearings, and where they are known.

    A line is laid through all returns within 0.3 m and six steps of each (total least squares); where fewer than
    three returns are near, or they make no line, there is no normal.
    """
    count = len(xy)
    if count < _LEAST:
        return np.zeros((count, 2)), np.zeros(count, dtype=bool)
    offsets = np.arange(-_MOST_STEPS, _MOST_STEPS + 1)
    index = np.arange(count)[:, None] + offsets
    inside = (index >= 0) & (index < count)
    near = xy[np.clip(index, 0, count - 1)] - xy[:, None, :]
    weight = (inside & (np.einsum("ijk,ijk->ij", near, near) < _REACH_M**2)).astype(np.float64)
    number = weight.sum(axis=1)
    mean = np.einsum("ij,ijk->ik", weight, near) / number[:, None]
    x, y = near[:, :, 0], near[:, :, 1]
    xx = np.einsum("ij,ij->i", weight, x * x) / number - mean[:, 0] ** 2
    yy = np.einsum("ij,ij->i", weight, y * y) / number - mean[:, 1] ** 2
    xy_ = np.einsum("ij,ij->i", weight, x * y) / number - mean[:, 0] * mean[:, 1]
    direction = 0.5 * np.arctan2(2.0 * xy_, xx - yy)
    half, middle = np.hypot(0.5 * (xx - yy), xy_), 0.5 * (xx + yy)
    small, large = np.maximum(middle - half, 0.0), middle + half
    known = (number >= _LEAST) & (small < _FLAT**2 * large)
    return np.stack((-np.sin(direction), np.cos(direction)), axis=1), known

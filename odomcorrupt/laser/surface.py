"""Surface normals at the returns of a sweep, from lines through the neighbours of each return."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

_REACH_M = 0.3
"""Largest distance of a return's neighbours, m."""
_MOST_STEPS = 6
_LEAST = 3
_FLAT = 0.3
"""Ratio of the scatter across a line to that along it above which the neighbours are not a line."""


class Lines(NamedTuple):
    """Lines through the neighbours of points: each point projected onto its line (n, 2), and the unit normal (n, 2)."""

    feet: Array
    normals: Array


def lines_of(xy: Array) -> Lines:
    """Return the surface lines at returns (m, 2) in the order of bearings.

    A line is fitted to all returns within 0.3 m and six steps of each one (total least squares). A return with fewer
    than three near ones, or whose neighbours are not a line, is left out. Projected points are less noisy than returns;
    the nearest of several noisy points would be biased towards the query point.
    """
    count = len(xy)
    if count < _LEAST:
        return Lines(np.zeros((0, 2)), np.zeros((0, 2)))
    offsets = np.arange(-_MOST_STEPS, _MOST_STEPS + 1)
    index = np.arange(count)[:, None] + offsets
    inside = (index >= 0) & (index < count)
    near = xy[np.clip(index, 0, count - 1)] - xy[:, None, :]
    weight = (inside & (np.einsum("ijk,ijk->ij", near, near) < _REACH_M**2)).astype(np.float64)
    return _fitted(xy, near, weight)


def _fitted(xy: Array, near: Array, weight: Array) -> Lines:
    """Return lines through weighted neighbours (n, k, 2), given relative to each point."""
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
    normal = np.stack((-np.sin(direction), np.cos(direction)), axis=1)[known]
    off = np.einsum("ij,ij->i", mean[known], normal)
    return Lines(xy[known] + off[:, None] * normal, normal)

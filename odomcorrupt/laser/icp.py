"""Point-to-line matching of a sweep with surfaces.

Iterated closest points with the point-to-line metric (Censi, "An ICP variant using a point-to-line metric", ICRA 2008),
a k-d tree for the nearest points, and Cauchy weights against people, glass and mixed pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from scipy.spatial import cKDTree

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array


LEAST_RETURNS = 20
"""Minimum number of returns matched to a surface for a pose."""
OVERLAP, SURE_OVERLAP = 0.35, 0.6
"""Least overlap of a match near the odometry's guess, and of one that is searched for or that sweeps are judged by."""
WEAK = 0.15
"""Ratio of the smaller to the larger eigenvalue of the position's information below which the weak axis is unknown."""
COARSE = 60
"""Number of returns with which the nearest of many guesses is found, and least number to begin from."""
_GATES_M = (0.5, 0.3, 0.2, 0.15)
_STEP_M, _STEP_RAD = 5e-4, 1e-4
_TUNING = 2.0
_FLAT = 1e-3
_PLAIN = 2.25 * _FLAT
"""Determinant of a 3 x 3 matrix with unit diagonal above which no eigenvalue is below `_FLAT`, because the product of
the other two is at most 9/4."""


class Surface(NamedTuple):
    """n points (n, 2) of surfaces with their unit normals (n, 2), in one frame, and their k-d tree."""

    points: Array
    normals: Array
    tree: cKDTree


@dataclass(frozen=True, slots=True)
class Match:
    """The pose of a sweep in a surface's frame.

    pose : (3,) m, m, rad
    information : (3, 3) of the pose in the surface's axes about the sweep's origin, for returns with independent errors
    deviation_m : robust standard deviation of the returns from the surfaces, m
    overlap : fraction of the returns within 12 cm of a surface point
    ratio : smaller over larger eigenvalue of the position's information, with the heading free
    weak_axis : (2,) unit vector of the smaller eigenvalue, in the surface's axes
    """

    pose: Array
    information: Array
    deviation_m: float
    overlap: float
    ratio: float
    weak_axis: Array


def surface_of(points: Array, normals: Array) -> Surface:
    """Return a surface of points and normals (n, 2) with a k-d tree."""
    return Surface(points, normals, cKDTree(points, leafsize=24, compact_nodes=False, balanced_tree=False))


def match(returns: Array, surface: Surface, guess: Array, gates_m: Sequence[float] = _GATES_M) -> Match | None:
    """Return the matched pose of returns (m, 2) in a surface's frame, started at a guess (3,); None if matching fails.

    gates_m : largest distance between a return and its surface point at each iteration; the last one is kept
    """
    if len(surface.points) < LEAST_RETURNS or len(returns) < LEAST_RETURNS:
        return None
    pose = np.array(guess, dtype=np.float64)
    for step in range(15):
        gate = gates_m[min(step, len(gates_m) - 1)]
        c, s = np.cos(pose[2]), np.sin(pose[2])
        lever = returns @ np.array([[c, s], [-s, c]])
        distance, index = surface.tree.query(lever + pose[:2], distance_upper_bound=gate)
        paired = np.flatnonzero(np.isfinite(distance))
        if len(paired) < LEAST_RETURNS:
            return None
        lever, index = lever[paired], index[paired]
        normal = surface.normals[index]
        miss = np.einsum("ij,ij->i", normal, surface.points[index] - lever - pose[:2])
        # at least 4 mm, the noise of good lasers
        deviation = max(1.4826 * _median(np.abs(miss)), 0.004)
        weight = 1.0 / (1.0 + (miss / (_TUNING * deviation)) ** 2)
        jacobian = np.empty((len(paired), 3))
        jacobian[:, :2] = normal
        jacobian[:, 2] = normal[:, 1] * lever[:, 0] - normal[:, 0] * lever[:, 1]
        weighted = jacobian * weight[:, None]
        information = jacobian.T @ weighted
        move = _step(information, weighted.T @ miss)
        values, vectors = _axes(information)
        # ratio of the eigenvalues, as for `WEAK`, below which the guess is kept along the weak axis
        if values[0] < 0.05 * values[1]:
            move[:2] = vectors[:, 1] * (vectors[:, 1] @ move[:2])
        pose += move
        if step >= len(gates_m) - 1 and abs(move[0]) + abs(move[1]) < _STEP_M and abs(move[2]) < _STEP_RAD:
            break
    values, vectors = _axes(information)
    return Match(
        pose=pose,
        information=information / deviation**2,
        deviation_m=deviation,
        overlap=float(np.count_nonzero(distance < 0.12)) / len(returns),
        ratio=float(values[0] / max(values[1], 1e-12)),
        weak_axis=vectors[:, 0],
    )


def _axes(information: Array) -> tuple[tuple[float, float], Array]:
    """Return eigenvalues, the smaller first, and eigenvectors (2, 2) of the position's information.

    The heading is marginalised: a single distant wall determines position or heading, not both.
    """
    (a, b, x), (_, c, y), (_, _, z) = information.tolist()
    z = max(z, 1e-12)
    a, b, c = a - x * x / z, b - x * y / z, c - y * y / z
    half, middle = math.hypot(0.5 * (a - c), b), 0.5 * (a + c)
    angle = 0.5 * math.atan2(2.0 * b, a - c)
    cos, sin = math.cos(angle), math.sin(angle)
    return (max(middle - half, 0.0), middle + half), np.array([[-sin, cos], [cos, sin]])


def best_guess(returns: Array, surface: Surface, guesses: Array, within_m: float = 0.25) -> Array:
    """Return that one of the guesses (g, 3), m and rad, with which returns (m, 2), m, are nearest to the surface.

    within_m : distance at which a return counts as not on the surface
    """
    c, s = np.cos(guesses[:, 2])[:, None], np.sin(guesses[:, 2])[:, None]
    x = c * returns[:, 0] - s * returns[:, 1] + guesses[:, 0, None]
    y = s * returns[:, 0] + c * returns[:, 1] + guesses[:, 1, None]
    distance, _ = surface.tree.query(np.stack((x, y), axis=2).reshape(-1, 2), distance_upper_bound=within_m)
    score = np.minimum(distance, within_m).reshape(x.shape).sum(axis=1)
    return guesses[int(np.argmin(score))]


def _step(information: Array, pull: Array) -> Array:
    """Return the Gauss-Newton step (3,), which is zero along axes without information."""
    scale = np.sqrt(np.maximum(information.diagonal(), 1e-12))
    scaled, goal = information / np.outer(scale, scale), pull / scale
    (a, d, e), (_, b, f), (_, _, c) = scaled.tolist()
    ab, de, df = b * c - f * f, e * f - d * c, d * f - b * e
    determinant = a * ab + d * de + e * df
    if determinant > _PLAIN:
        # no eigenvalue is near zero: the inverse by cofactors is the same and takes a fifth of the time
        inverse = np.array([[ab, de, df], [de, a * c - e * e, d * e - a * f], [df, d * e - a * f, a * b - d * d]])
        return inverse @ goal / (determinant * scale)
    values, vectors = np.linalg.eigh(scaled)
    kept = np.where(values > _FLAT, 1.0 / np.maximum(values, _FLAT), 0.0)
    return (vectors @ (kept * (vectors.T @ goal))) / scale


def _median(values: Array) -> float:
    """Return the upper median of values (n,), faster than numpy's median."""
    middle = len(values) // 2
    return float(np.partition(values, middle)[middle])


def thinned(scan: Array, count: int) -> Array:
    """Return about `count` returns of a scan, evenly spread."""
    return scan[:: max(1, len(scan) // count)]


_NEIGHBOURS = 6
_LEAST = 3


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
    offsets = np.arange(-_NEIGHBOURS, _NEIGHBOURS + 1)
    index = np.arange(count)[:, None] + offsets
    inside = (index >= 0) & (index < count)
    near = xy[np.clip(index, 0, count - 1)] - xy[:, None, :]
    # largest distance of a return's neighbours, m
    weight = (inside & (np.einsum("ijk,ijk->ij", near, near) < 0.3**2)).astype(np.float64)
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
    # ratio of the scatter across a line to that along it above which the neighbours are not a line
    known = (number >= _LEAST) & (small < 0.3**2 * large)
    normal = np.stack((-np.sin(direction), np.cos(direction)), axis=1)[known]
    off = np.einsum("ij,ij->i", mean[known], normal)
    return Lines(xy[known] + off[:, None] * normal, normal)

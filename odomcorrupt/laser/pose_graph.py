"""Robust planar pose graph: poses of keyframes from relative poses between pairs of them.

Gauss-Newton on SE(2) with sparse normal equations; inconsistent relative poses are down-weighted
(Geman-McClure, as in dynamic covariance scaling: Agarwal et al., ICRA 2013).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.linalg import splu

from odomcorrupt.geometry.se2 import between, wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

_ROUNDS = 12
_STEP = 1e-4
_KERNEL = 12.0
"""Squared normalised residual at which a robust edge has a quarter of its weight."""


@dataclass(frozen=True, slots=True)
class Edges:
    """A set of e relative poses.

    first, second : (e,) indices of the poses they connect
    pose : (e, 3) pose of the second in the frame of the first
    information : (e, 3, 3) of that pose, in the first's axes
    robust : (e,) whether the edge may be an outlier
    """

    first: NDArray[np.int64]
    second: NDArray[np.int64]
    pose: Array
    information: Array
    robust: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.first)


def optimise(poses: Array, edges: Edges, rounds: int = _ROUNDS) -> tuple[Array, Array]:
    """Return the most likely poses (n, 3), with the first one fixed, and the final weights (e,) of the edges."""
    poses = poses.copy()
    weight = np.ones(len(edges))
    count = len(poses)
    if count < 2 or not len(edges):
        return poses, weight
    i, j = edges.first, edges.second
    rows = (3 * np.stack((i, j), axis=1)[:, :, None] + np.arange(3)).reshape(len(edges), 6)
    at = np.repeat(rows[:, :, None], 6, axis=2), np.repeat(rows[:, None, :], 6, axis=1)
    for _ in range(rounds):
        a, b = poses[i], poses[j]
        seen = between(a, b)
        miss = seen - edges.pose
        miss[:, 2] = wrap(miss[:, 2])
        chi2 = np.einsum("ei,eij,ej->e", miss, edges.information, miss)
        weight = np.where(edges.robust, (_KERNEL / (_KERNEL + chi2)) ** 2, 1.0)
        c, s = np.cos(a[:, 2]), np.sin(a[:, 2])
        left = np.zeros((len(edges), 3, 3))
        left[:, 0, 0], left[:, 0, 1], left[:, 1, 0], left[:, 1, 1] = -c, -s, s, -c
        left[:, 0, 2], left[:, 1, 2], left[:, 2, 2] = seen[:, 1], -seen[:, 0], -1.0
        right = -left.copy()
        right[:, :2, 2], right[:, 2, 2] = 0.0, 1.0
        jacobian = np.concatenate((left, right), axis=2)
        pulled = np.swapaxes(jacobian, 1, 2) @ (edges.information * weight[:, None, None])
        blocks = pulled @ jacobian
        gradient = np.zeros(3 * count)
        np.add.at(gradient, rows.ravel(), (pulled @ miss[:, :, None])[:, :, 0].ravel())
        normal = coo_array((blocks.ravel(), (at[0].ravel(), at[1].ravel())), shape=(3 * count, 3 * count)).tocsc()
        inner = normal[3:, 3:] + 1e-9 * _eye(3 * count - 3)
        step = np.zeros(3 * count)
        step[3:] = -splu(inner.tocsc()).solve(gradient[3:])
        poses += step.reshape(-1, 3)
        if float(np.abs(step).max()) < _STEP:
            break
    return poses, weight


def _eye(size: int) -> coo_array:
    index = np.arange(size)
    return coo_array((np.ones(size), (index, index)), shape=(size, size)).tocsc()

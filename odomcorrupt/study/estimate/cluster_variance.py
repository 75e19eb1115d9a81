"""Cluster-robust variance: observed over predicted variance of estimates between blocks of time of a drive.

Sums over blocks are valid even if the noise model is wrong. With few blocks their variance is uncertain, so it is
shrunk towards that of the other columns, as limma does for few arrays (Smyth 2004, section 3).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.problem import Problem

PRIOR_DOF = 20.0
"""Weight of the variance ratio shared by all columns, in degrees of freedom."""
_LENGTH_S, _FEWEST, _MOST = 15.0, 20, 60


def block_of(problem: Problem) -> NDArray[np.int64]:
    """Return the block index (K,) of each interval: blocks are about 15 s long and never span two runs."""
    nodes, run = problem.nodes, problem.run
    total = float(np.sum(nodes.end_s - nodes.start_s))
    length = total / int(np.clip(total / _LENGTH_S, _FEWEST, _MOST))
    within = np.concatenate([_elapsed(nodes.end_s[run == r], length) for r in np.unique(run)])
    block: NDArray[np.int64] = np.unique(np.stack((run, within)), axis=1, return_inverse=True)[1].ravel()
    return block


def _elapsed(end_s: Array, length: float) -> NDArray[np.int64]:
    index: NDArray[np.int64] = ((end_s - end_s[0]) / length).astype(np.int64)
    return index


def between_blocks(block: NDArray[np.int64], pull: Array, r: Array) -> tuple[Array, Array]:
    """Return observed over predicted variance of estimates between blocks, and its degrees of freedom, (p,) each.

    block, r : (m,) block index of each innovation, and the innovations
    pull : (m, p) weight of each innovation in each estimate
    """
    moved, known = block_sums(block, pull * r[:, None]), block_sums(block, pull**2)
    whole = np.maximum(known.sum(axis=0), 1e-300)
    parts = known / whole
    left = moved - parts * moved.sum(axis=0)
    variance: Array = (left**2 / np.maximum(1.0 - parts, 1e-6)).sum(axis=0) / whole
    dof: Array = np.maximum(1.0 / np.maximum(np.sum(parts**2, axis=0), 1e-300) - 1.0, 0.5)
    return variance, dof


def block_sums(block: NDArray[np.int64], values: Array) -> Array:
    """Return the sums (blocks, p) over each block of values (m, p)."""
    sums: Array = np.stack([np.bincount(block, column) for column in values.T], axis=1).astype(np.float64)
    return sums


def shared_variance(variance: Array, dof: Array) -> float:
    """Return the mean variance ratio of all columns, weighted by degrees of freedom; at least 1 (model correct)."""
    return max(float(np.average(variance, weights=dof)), 1.0) if len(variance) else 1.0


def inflation(variance: Array, dof: Array, shared: float) -> Array:
    """Return the variance ratio of each column, shrunk towards the shared one; at least 1."""
    moderated: Array = np.maximum(1.0, (PRIOR_DOF * shared + dof * variance) / (PRIOR_DOF + dof))
    return moderated

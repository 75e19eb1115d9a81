"""Blocks of a drive: how much a score really varies between stretches of it, beside what the noise model says.

A sum over blocks is right where the noise model is not; few blocks know little of their own spread, and borrow strength
from what is said of other columns, as limma does for few arrays (Smyth 2004, section 3).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.problem import Problem

__all__ = ["PRIOR_DOF", "between_blocks", "block_of", "block_sums", "inflation", "shared_variance"]

PRIOR_DOF = 20.0
"""Degrees of freedom that the common opinion is worth."""
_LENGTH_S, _FEWEST, _MOST = 15.0, 20, 60


def block_of(problem: Problem) -> NDArray[np.int64]:
    """Return the block (K,) each interval belongs to: stretches of time, never across runs, about 15 s each."""
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
    """Return by how much estimates vary between blocks, 1 if as the model says, and degrees of freedom, (p,) each.

    block, r : (m,) where each innovation is, and the innovations
    pull : (m, p) what each of them does to each estimate
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
    """Return the common opinion on how much scores vary between blocks, 1 where as the model says, and never less."""
    return max(float(np.average(variance, weights=dof)), 1.0) if len(variance) else 1.0


def inflation(variance: Array, dof: Array, shared: float) -> Array:
    """Return by how much scores vary more between blocks than the model says, at least 1."""
    moderated: Array = np.maximum(1.0, (PRIOR_DOF * shared + dof * variance) / (PRIOR_DOF + dof))
    return moderated

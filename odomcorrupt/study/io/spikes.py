"""Removal of spikes: a few poses that disagree with both neighbours while the neighbours agree with each other.

Swapped markers turn a pose by any angle, often by less than the threshold of a jump. One side of it may then look like
motion and the other like a jump of everything that follows, so spikes are removed before jumps are detected. Only poses
are tested, not stamps: stamps may be bunched, and a late pose still belongs to the path.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

__all__ = ["without_spikes"]

LONGEST = 5
"""Longest spike in poses; longer ones are left to the detection of jumps."""
_ROUNDS = 20


def without_spikes(t_s: Array, xyt: Array, top: Array, limit: Array) -> NDArray[np.int64]:
    """Return the indices of the poses that are not spikes.

    Parameters
    ----------
    t_s, xyt : (n,), (n, 3)
        Times and poses, seconds, metres and radians.
    top : (2,)
        Usual top speed and turn rate of the robot, m/s and rad/s.
    limit : (2,)
        Upper bound of the noise, m and rad.

    """
    kept = np.arange(len(t_s))
    for _ in range(_ROUNDS):
        own_s, own_xyt = t_s[kept], xyt[kept]
        over = _apart(own_xyt[:-1], own_xyt[1:]) > limit + top * np.diff(own_s)[:, None]
        steps = over[:, 0] | over[:, 1]
        found = (_spikes(own_s, own_xyt, top, limit, steps, count) for count in range(1, LONGEST + 1) if steps.any())
        # The shortest spikes first; the remaining poses are tested again without them.
        bad = next((rows for rows in found if len(rows)), None)
        if bad is None:
            break
        kept = np.delete(kept, bad)
    return kept


def _spikes(
    t_s: Array, xyt: Array, top: Array, limit: Array, stands_out: NDArray[np.bool_], count: int
) -> NDArray[np.int64]:
    """Return the indices of all spikes of `count` consecutive poses, given the steps (n - 1,) above the limit."""
    # A spike begins and ends with a large step; on at least one side, the adjacent step is small.
    before = np.flatnonzero(stands_out)
    after = before + count + 1
    inside = (before >= 1) & (after < len(t_s) - 1)
    before, after = before[inside], after[inside]
    trusted = stands_out[after - 1] & ~(stands_out[before - 1] & stands_out[after])
    before, after = before[trusted], after[trusted]
    moved = _apart(xyt[before], xyt[after])
    slack = limit + top * (t_s[after] - t_s[before])[:, None]
    # The smallest deviation of the poses in between, because each of them must be wrong.
    least = np.full(moved.shape, np.inf)
    for i in range(1, count + 1):
        least = np.minimum(least, _off(xyt[before], xyt[before + i], xyt[after]))
    # The neighbours agree if their distance is within the limit, or below the deviation of the spike.
    spike = (moved < np.maximum(slack, least)).all(axis=1) & (least > slack).any(axis=1)
    rows: NDArray[np.int64] = (before[spike][:, None] + np.arange(1, count + 1)).ravel()
    return rows


def _apart(a_xyt: Array, b_xyt: Array) -> Array:
    """Return the distances (n, 2) between poses (n, 3), m and rad."""
    gone = np.linalg.norm(b_xyt[:, :2] - a_xyt[:, :2], axis=1)
    return np.stack((gone, np.abs(wrap(b_xyt[:, 2] - a_xyt[:, 2]))), axis=1)


def _off(a_xyt: Array, xyt: Array, b_xyt: Array) -> Array:
    """Return the deviations (n, 2) of poses (n, 3) from the straight line between a and b, m and rad."""
    way, gone = b_xyt[:, :2] - a_xyt[:, :2], xyt[:, :2] - a_xyt[:, :2]
    part = np.clip(np.sum(way * gone, axis=1) / np.maximum(np.sum(way**2, axis=1), 1e-12), 0.0, 1.0)
    off_m = np.linalg.norm(gone - part[:, None] * way, axis=1)
    turn, turned = wrap(b_xyt[:, 2] - a_xyt[:, 2]), wrap(xyt[:, 2] - a_xyt[:, 2])
    nearest = np.clip(turned, np.minimum(turn, 0.0), np.maximum(turn, 0.0))
    return np.stack((off_m, np.abs(wrap(turned - nearest))), axis=1)

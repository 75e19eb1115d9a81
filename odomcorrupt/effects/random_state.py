"""State of random effects: copies of generators, and autoregressive processes over uneven intervals."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array


def copied(rng: np.random.Generator) -> np.random.Generator:
    """Return a copy of a generator, so that a state can be continued more than once."""
    return copy.deepcopy(rng)


def autoregression(start: float, keep: Array, kick: Array) -> Array:
    """Return x (n,) with x_i = keep_i x_(i-1) + kick_i, computed sequentially so that splitting gives the same bits.

    start : x before the first one
    keep, kick : (n,) factors and additions
    """
    x = start
    return np.array([x := kept * x + kicked for kept, kicked in zip(keep.tolist(), kick.tolist(), strict=True)])

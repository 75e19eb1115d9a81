"""Seeded streams of random numbers.

A stream is a function of (seed, run, name, ordinal) alone: the same in a single call and in a batch, on any number of
workers, for any division of the bag into blocks.
"""

from __future__ import annotations

import hashlib
import secrets
from typing import SupportsIndex

import numpy as np

from odomcorrupt.errors import ModelError

SEED_LIMIT = 2**63
"""Exclusive upper limit of seeds, so that they fit a signed 64-bit field wherever they are stored."""


def draw_seed() -> int:
    """Return a random seed from the operating system's entropy, short enough to be typed."""
    return secrets.randbelow(2**32)


def stream(seed: int, run: int, name: str, ordinal: int = 0) -> np.random.Generator:
    """Return the random generator of one purpose (`name`: "noise" or an effect) of one run.

    Different names, ordinals or runs have independent streams: each has its own spawn key of the seed.
    """
    if not (isinstance(seed, SupportsIndex) and 0 <= seed < SEED_LIMIT):
        raise ModelError(f"seed: {seed}; it must be a whole number from 0 to 2^63 - 1")
    if not (isinstance(run, SupportsIndex) and run >= 0):
        raise ModelError(f"run: {run}; runs are counted from 0")
    key = int.from_bytes(hashlib.sha256(name.encode()).digest()[:8], "little")
    sequence = np.random.SeedSequence(seed, spawn_key=(run, key & 0xFFFFFFFF, key >> 32, ordinal))
    return np.random.Generator(np.random.PCG64(sequence))

"""Gaps between the records that an index lists."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray


def gaps_between(starts: NDArray[np.int64], ends: NDArray[np.int64], size: int) -> list[tuple[int, int]] | None:
    """Return the spans of [0, size) not covered by records (n,), sorted by start; None where these overlap.

    If the gaps consist of whole records, none of the indexed kind, the index is correct and complete.
    """
    befores, afters = np.concatenate(([0], ends)), np.concatenate((starts, [size]))
    (open_ones,) = (befores != afters).nonzero()
    if not open_ones.size:
        return []
    befores, afters = befores[open_ones], afters[open_ones]
    if (befores > afters).any():
        return None
    return list(zip(befores.tolist(), afters.tolist(), strict=True))


def windows(data: NDArray[np.uint8], width: int) -> NDArray[np.void]:
    """Return a view of data as overlapping windows, one per byte, to index whole unaligned fields."""
    if data.size < width:
        return np.empty(0, dtype=f"V{width}")
    return np.ndarray((data.size - width + 1,), dtype=f"V{width}", buffer=data, strides=(1,))

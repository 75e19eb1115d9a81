"""Put samples in the order of their stamps, and leave out what no order can save.

A few swapped or repeated stamps are sorted. A clock that is set back while recording (a simulation started again, a
bag played in a loop) makes two runs with the same stamps: the longest stretch is kept, because sorting would interleave
them. So it is where a clock is set forward by more than an hour (a robot that learns the date after it has started).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["Order", "in_order", "order_of"]

_BACK_NS = 1_000_000_000
_FORWARD_NS = 3_600_000_000_000
_NEIGHBOURS = 5
_FAR_M = 1e9
"""And 1e9 radians: what is larger is no number either."""


@dataclass(frozen=True, slots=True)
class Order:
    """Which of the samples to take.

    rows : (k,) indices into the samples, in the order of growing stamps
    stamps_ns : (k,) their stamps, strictly growing
    notes : what was left out
    """

    rows: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    notes: tuple[str, ...]


def order_of(stamps_ns: NDArray[np.int64], log_ns: NDArray[np.int64]) -> Order:
    """Return the order of samples by stamps (n,), as they arrived; log times (n,) stand in for missing stamps."""
    rows = np.arange(len(stamps_ns))
    notes = []
    if len(log_ns):
        if not stamps_ns.any():
            stamps_ns = log_ns
            notes.append("no stamps in the messages, log times taken")
        elif not stamps_ns.all():
            rows = np.flatnonzero(stamps_ns)
            notes.append(f"{len(stamps_ns) - len(rows)} poses without a stamp left out")
    stamps = stamps_ns[rows]
    starts = _set_back(stamps)
    if len(starts):
        pieces = np.split(rows, starts)
        rows = max(pieces, key=len)
        left = sum(map(len, pieces)) - len(rows)
        notes.append(f"its clock is set back {len(starts)} times: the longest stretch kept, {left} poses left out")
    stamps = stamps_ns[rows]
    swapped = int(np.sum(np.diff(stamps) < 0))
    unique, index = np.unique(stamps, return_index=True)
    rows = rows[index]
    if swapped:
        notes.append(f"{swapped} stamps out of order sorted")
    if len(stamps) > len(unique):
        notes.append(f"{len(stamps) - len(unique)} poses with the stamp of another left out")
    ahead = np.flatnonzero(np.diff(unique) > _FORWARD_NS) + 1
    if len(ahead):
        kept = max(np.split(np.arange(len(unique)), ahead), key=len)
        notes.append(f"its stamps jump by more than an hour: {len(unique) - len(kept)} poses left out")
        rows, unique = rows[kept], unique[kept]
    return Order(rows, unique, tuple(notes))


def in_order(samples: Samples) -> Samples:
    """Return the samples that are numbers, by growing stamps.

    Raises
    ------
    RecordingError
        Where fewer than two are left.

    """
    found = len(samples)
    if not found:
        raise RecordingError(f"{samples.place} holds no message; name another topic")
    # a comparison with what is no number is false
    good = np.asarray((np.abs(samples.xyz) < _FAR_M).all(axis=1))
    if not good.any():
        raise RecordingError(f"{samples.place}: none of its {found} positions is a number; name another source")
    if not good.all():
        samples = samples.only(good, f"{np.sum(~good)} positions that are no numbers left out")
    headless: NDArray[np.bool_] = ~(np.abs(samples.yaw_rad) < _FAR_M)
    if headless.all():
        samples = samples.without_headings()
    elif headless.any():
        samples = samples.only(~headless, f"{np.sum(headless)} poses without a heading left out")
    order = order_of(samples.stamps_ns, samples.log_ns)
    if len(order.rows) < 2:
        raise RecordingError(
            f"{samples.place}: {found} poses, {len(order.rows)} of them with a stamp and numbers of their own; "
            "it takes many more"
        )
    return samples.only(order.rows, *order.notes).stamped(order.stamps_ns)


def _set_back(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return where stretches start that lie more than a second before what came just before them."""
    if len(stamps) < 2 * _NEIGHBOURS:
        return np.zeros(0, dtype=np.int64)
    window = np.lib.stride_tricks.sliding_window_view(stamps, _NEIGHBOURS)
    before, after = np.median(window[:-_NEIGHBOURS], axis=1), window[_NEIGHBOURS:].max(axis=1)
    # float64 medians of nanoseconds are off by 256 ns: nothing against a second
    behind = after < before - _BACK_NS
    places: NDArray[np.int64] = np.flatnonzero(behind) + _NEIGHBOURS
    return places[stamps[places] < stamps[places - 1] - _BACK_NS]

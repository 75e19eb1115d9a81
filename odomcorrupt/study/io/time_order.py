"""Sorting of samples by stamp, and removal of those that sorting cannot repair.

A few swapped or repeated stamps are sorted. A clock set back while recording (a restarted simulation, a looping bag)
gives two runs with the same stamps; sorting would interleave them, so only the longest stretch is kept. The same holds
for a clock set forward by more than an hour (a robot that receives the date after its start).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.study.io.raw_trajectory import Samples

_BACK_NS = 1_000_000_000  # smallest step back that begins another run
_FORWARD_NS = 3_600_000_000_000
_NEIGHBOURS = 5
_FAR_M = 1e9
"""Larger positions (metres) and headings (radians) count as invalid."""


@dataclass(frozen=True, slots=True)
class Order:
    """Selection and order of the usable samples.

    rows : (k,) indices into the samples, in order of increasing stamps
    stamps_ns : (k,) their stamps, strictly increasing
    notes : removals, for reports
    """

    rows: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    notes: tuple[str, ...]


def order_of(stamps_ns: NDArray[np.int64], log_ns: NDArray[np.int64]) -> Order:
    """Return the order of samples with stamps (n,) in order of arrival; log times (n,) replace missing stamps."""
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
    """Return the samples with finite values, in order of increasing stamps.

    Raises
    ------
    RecordingError
        If fewer than two remain.
    """
    found = len(samples)
    if not found:
        raise RecordingError(f"{samples.place} holds no message; name another topic")
    # comparisons with NaN are false
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
    """Return the start indices of stretches that begin more than a second before the preceding stamps."""
    if len(stamps) < 2 * _NEIGHBOURS:
        return np.zeros(0, dtype=np.int64)
    window = np.lib.stride_tricks.sliding_window_view(stamps, _NEIGHBOURS)
    before, after = np.median(window[:-_NEIGHBOURS], axis=1), window[_NEIGHBOURS:].max(axis=1)
    # float64 medians of nanoseconds are off by up to 256 ns, which is negligible here
    behind = after < before - _BACK_NS
    places: NDArray[np.int64] = np.flatnonzero(behind) + _NEIGHBOURS
    return places[stamps[places] < stamps[places - 1] - _BACK_NS]

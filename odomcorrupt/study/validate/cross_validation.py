"""Splitting of fitted recordings in two halves for cross-validation: fit on one half, evaluate on the other.

Stretches between resets still belong to one run: the run has one middle, and each half may have several stretches.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.trajectory import distance_along
from odomcorrupt.study.estimate.interval_ends import LEAST_INTERVALS, count_intervals
from odomcorrupt.study.io.clock import clock_leaders

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Recording

_MIN_FRACTION = 0.25
"""Least fraction of the distance in a half; with less (the robot rested or crept) a half is not informative."""


@dataclass(frozen=True, slots=True)
class Pieces:
    """Evaluated parts of a run: each half has one or more stretches; the second is empty if the run is not split.

    names : names of the run's recordings
    """

    names: frozenset[str]
    first: tuple[Recording, ...]
    second: tuple[Recording, ...] = ()

    @property
    def all(self) -> tuple[Recording, ...]:
        """All stretches, those of the first half first."""
        return (*self.first, *self.second)


@dataclass(frozen=True, slots=True)
class _Middle:
    """Stamp of the truth at which the second half begins, and a note, if any."""

    stamp_ns: int
    note: str = ""


@dataclass(frozen=True, slots=True)
class Split:
    """Split of recordings, independent of their clocks.

    middles : of each run, None if it is evaluated as a whole
    kept : indices of the runs that are long enough
    spacing_s : length of the intervals
    notes : exceptions, for reports
    """

    middles: tuple[_Middle | None, ...]
    kept: tuple[int, ...]
    spacing_s: float
    notes: tuple[str, ...]

    def pieces(self, recordings: Sequence[Recording]) -> list[Pieces]:
        """Return the evaluated parts of each run."""
        runs = _runs(recordings)
        return [_pieces(runs[i], self.middles[i], self.spacing_s) for i in self.kept]


def split_of(recordings: Sequence[Recording], fitted: Collection[str], spacing_s: float) -> Split:
    """Return how to split recordings (clocks corrected): those named in `fitted` in halves, the others not at all.

    If no run is long enough, all are evaluated as a whole, on the data that the model was fitted to.
    """
    runs = _runs(recordings)
    middles = tuple(_middle(run) if any(r.name in fitted for r in run) else None for run in runs)
    kept, notes = [], [middle.note for middle in middles if middle is not None and middle.note]
    for i, (run, middle) in enumerate(zip(runs, middles, strict=True)):
        pieces = _pieces(run, middle, spacing_s)
        if middle is None or (pieces.first and pieces.second):
            kept.append(i)
        else:
            word = "second" if pieces.first else "first"
            notes.append(
                f"{run[0].name}: too short to be fitted on one half and evaluated on the other: its {word} half has no "
                f"{LEAST_INTERVALS} stretches of {spacing_s:g} s with both odometry and truth"
            )
    if not kept:
        notes[-1] += (
            ". Errors and likelihood are those on the fitted data, which every model explains best: record longer, or "
            "evaluate on another recording"
        )
        return Split((None,) * len(runs), tuple(range(len(runs))), spacing_s, tuple(notes))
    return Split(middles, tuple(kept), spacing_s, tuple(notes))


def _runs(recordings: Sequence[Recording]) -> list[list[Recording]]:
    """Return the recordings grouped by shared clock, so that stretches of one run are together."""
    runs: dict[int, list[Recording]] = {}
    for leader, recording in zip(clock_leaders(recordings), recordings, strict=True):
        runs.setdefault(leader, []).append(recording)
    return list(runs.values())


def _middle(run: Sequence[Recording]) -> _Middle:
    """Return the middle of a run in time, or in distance if one of its halves would hardly move."""
    stamps, distance_m = _distance(run)
    if not len(stamps):
        raise RecordingError(f"{run[0].name}: odometry and truth have no time in common; check the two clocks")
    middle = len(stamps) // 2
    share = distance_m[middle] / max(distance_m[-1], 1e-9)
    if distance_m[-1] <= 0.0 or _MIN_FRACTION <= share <= 1.0 - _MIN_FRACTION:
        return _Middle(int(stamps[middle]))
    by_distance = int(np.searchsorted(distance_m, distance_m[-1] / 2.0))
    at_s = float(stamps[by_distance] - stamps[0]) * 1e-9
    still = "first" if share < _MIN_FRACTION else "second"
    note = f"{run[0].name}: hardly moves in the {still} half of its time: cut at half of its way, after {at_s:.0f} s"
    return _Middle(int(stamps[by_distance]), note)


def _pieces(run: Sequence[Recording], middle: _Middle | None, spacing_s: float) -> Pieces:
    """Return a run split at its middle, if it has one, without stretches of too few intervals of `spacing_s`."""
    names = frozenset(recording.name for recording in run)
    if middle is None:
        return Pieces(names, tuple(run))
    sides: tuple[list[Recording], list[Recording]] = ([], [])
    for recording in run:
        truth = recording.truth
        at = int(np.searchsorted(truth.stamps_ns, middle.stamp_ns))
        for side, word, rows in zip(sides, ("first", "second"), (slice(at), slice(at, None)), strict=True):
            if len(truth.stamps_ns[rows]) > LEAST_INTERVALS:
                side.append(replace(recording, name=f"{recording.name}, {word} half", truth=truth.only(rows)))
    first, second = (tuple(r for r in side if count_intervals(r, spacing_s) >= LEAST_INTERVALS) for side in sides)
    return Pieces(names, first, second)


def _distance(run: Sequence[Recording]) -> tuple[NDArray[np.int64], Array]:
    """Return the truth's stamps (n,) in the time of the odometry, sorted, and the distance travelled (n,), m."""
    stamps, gone = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
    for recording in run:
        inside = recording.within_odometry
        distance_m = np.interp(recording.truth_s[inside], recording.odometry_s, distance_along(recording.odometry.xyt))
        stamps.append(recording.truth.stamps_ns[inside])
        gone.append(np.diff(distance_m, prepend=distance_m[:1]))
    every = np.concatenate(stamps)
    order = np.argsort(every, kind="stable")
    return every[order], np.cumsum(np.concatenate(gone)[order])

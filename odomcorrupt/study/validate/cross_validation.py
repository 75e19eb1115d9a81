"""Folds of the fitted recordings for cross-validation: a model is refitted without a fold and evaluated on it.

Folds are whole runs, or the halves of a single one; a refit uses all others together, because a single run may not show
every effect. It is weakly held by the fit of all recordings, so that an effect that the others do not show stays where
it was. Folds depend neither on the names of the recordings nor on their order.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.trajectory import distance_along
from odomcorrupt.study.estimate.intervals import LEAST_INTERVALS, count_intervals
from odomcorrupt.study.io.clock import clock_leaders
from odomcorrupt.study.io.recording import ranks_of

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.study.io.recording import Recording

_MOST_FOLDS = 5
"""Number of folds of many runs (Hastie, Tibshirani & Friedman 2009, section 7.10: five or ten)."""
HELD_BY = 10.0
"""Standard deviations within which a refit is held by the fit of all recordings: a hundredth of their information."""


@dataclass(frozen=True, slots=True)
class Fold:
    """Recordings to evaluate on, and the others of the fitted ones; none: they were not fitted, or cannot be split."""

    test: tuple[Recording, ...]
    train: tuple[Recording, ...] = ()

    @property
    def inflation(self) -> float:
        """Factor of the standard errors of a refit, which has fewer data than the fit of all recordings."""
        if not self.train:
            return 1.0
        own, others = (sum(_seconds(r) for r in part) for part in (self.test, self.train))
        return float(np.sqrt(1.0 + own / others))


@dataclass(frozen=True, slots=True)
class Split:
    """Split of recordings into folds, independent of their clocks.

    groups : indices of the runs of each fold; a fold of a run that was not fitted has it alone
    fitted : whether each fold was fitted
    middle_ns : stamp of the truth at which the only fitted run is cut in halves; None if it is not
    spacing_s : length of the intervals
    notes : exceptions, for reports
    """

    groups: tuple[tuple[int, ...], ...]
    fitted: tuple[bool, ...]
    middle_ns: int | None
    spacing_s: float
    notes: tuple[str, ...]

    def folds(self, recordings: Sequence[Recording]) -> list[Fold]:
        """Return the folds of the recordings."""
        runs = _runs(recordings)
        parts = [tuple(recordings[n] for i in group for n in runs[i]) for group in self.groups]
        found: list[Fold] = []
        for part, fitted in zip(parts, self.fitted, strict=True):
            if fitted and self.middle_ns is not None:
                halves = _halves(part, self.middle_ns, self.spacing_s)
                found += [Fold(halves[0], halves[1]), Fold(halves[1], halves[0])]
            else:
                others = [other for other, own in zip(parts, self.fitted, strict=True) if own and other is not part]
                found.append(Fold(part, tuple(r for other in others for r in other) if fitted else ()))
        return found


def split_of(recordings: Sequence[Recording], fitted: Sequence[bool], spacing_s: float) -> Split:
    """Return how to split recordings (clocks corrected); `fitted` says which of them models were fitted to."""
    rows = _runs(recordings)
    known = [any(fitted[n] for n in own) for own in rows]
    runs = [[recordings[n] for n in own] for own in rows]
    own = [i for i, is_known in enumerate(known) if is_known]
    others = [(i,) for i, is_known in enumerate(known) if not is_known]
    enough = [i for i in own if sum(count_intervals(r, spacing_s) for r in runs[i]) >= LEAST_INTERVALS] or own
    ranks = ranks_of(recordings)
    longest_first = sorted(enough, key=lambda i: (-sum(_seconds(r) for r in runs[i]), ranks[rows[i][0]]))
    groups = [tuple(sorted(longest_first[k::_MOST_FOLDS])) for k in range(min(len(enough), _MOST_FOLDS))]
    # runs that are too short for a fit of their own are grouped with the longest
    groups[:1] = [tuple(sorted((*group, *(i for i in own if i not in enough)))) for group in groups[:1]]
    middle, notes = None, list[str]()
    if len(groups) == 1:
        run = [recording for i in groups[0] for recording in runs[i]]
        middle = _middle(run)
        sides = _halves(run, middle, spacing_s)
        if not all(sides):
            middle = None
            notes.append(
                f"{run[0].name}: too short to be fitted on one half and evaluated on the other: its "
                f"{'second' if sides[0] else 'first'} half has no {LEAST_INTERVALS} stretches of {spacing_s:g} s with "
                "both odometry and truth. Errors and likelihood are those on the fitted data, which every model "
                "explains best: record longer, or evaluate on another recording"
            )
    every = (*groups, *others)
    return Split(every, tuple(known[group[0]] for group in every), middle, spacing_s, tuple(notes))


def _seconds(recording: Recording) -> float:
    """Return the duration of a recording's truth within its odometry, s."""
    inside = recording.truth.stamps_ns[recording.within_odometry]
    return float(inside[-1] - inside[0]) * 1e-9 if len(inside) else 0.0


def _runs(recordings: Sequence[Recording]) -> list[list[int]]:
    """Return the indices of recordings grouped by shared clock, so that stretches of one run are together."""
    runs: dict[int, list[int]] = {}
    for n, leader in enumerate(clock_leaders(recordings)):
        runs.setdefault(leader, []).append(n)
    return list(runs.values())


def _middle(run: Sequence[Recording]) -> int:
    """Return the stamp of a run's middle in time, or in distance if one of its halves would hardly move."""
    every, gone = [np.zeros(0, dtype=np.int64)], [np.zeros(0)]
    for recording in run:
        inside = recording.within_odometry
        so_far_m = np.interp(recording.truth_s[inside], recording.odometry_s, distance_along(recording.odometry.xyt))
        every.append(recording.truth.stamps_ns[inside])
        gone.append(np.diff(so_far_m, prepend=so_far_m[:1]))
    stamps = np.concatenate(every)
    if not len(stamps):
        raise RecordingError(f"{run[0].name}: odometry and truth have no time in common; check the two clocks")
    order = np.argsort(stamps, kind="stable")
    stamps, distance_m = stamps[order], np.cumsum(np.concatenate(gone)[order])
    in_time, half_m = len(stamps) // 2, 0.5 * distance_m[-1]
    rests = abs(distance_m[in_time] - half_m) > 0.5 * half_m
    return int(stamps[np.searchsorted(distance_m, half_m) if rests else in_time])


def _halves(
    run: Sequence[Recording], middle_ns: int, spacing_s: float
) -> tuple[tuple[Recording, ...], tuple[Recording, ...]]:
    """Return the stretches of both halves of a run, without those of too few intervals of `spacing_s`."""
    sides: tuple[list[Recording], list[Recording]] = ([], [])
    for recording in run:
        truth = recording.truth
        at = int(np.searchsorted(truth.stamps_ns, middle_ns))
        for side, word, rows in zip(sides, ("first", "second"), (slice(at), slice(at, None)), strict=True):
            if len(truth.stamps_ns[rows]) > LEAST_INTERVALS:
                side.append(replace(recording, name=f"{recording.name}, {word} half", truth=truth.only(rows)))
    first, second = (tuple(r for r in side if count_intervals(r, spacing_s) >= LEAST_INTERVALS) for side in sides)
    return first, second

"""Stamps that are not when poses were taken: rounded ones, and clocks that are set while recording.

Drivers and loggers cut stamps to milliseconds, or to hundredths of a second: an offset of less than half of that is no
clock's. A network time daemon that steps a clock shifts all stamps from there on: against the recorder's own times,
which go on evenly, the stamps jump, and what lies before and after has a clock of its own.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.geometry.rounded_stamps import evened, resolution_s

if TYPE_CHECKING:
    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["Step", "between_steps", "clock_steps", "even_stamps", "stamp_resolution_s"]

_STEP_S = (0.02, 1.0)
"""Smallest and largest step of a clock that is searched; a clock set back by more begins another run (`time_order`)."""
_BESIDE, _LEAST = 25, 10
"""Samples on each side of a step that show that it lasts; at least so many are needed."""
_ALIKE = 0.3
"""How well steps of single stamps, and of those around them, have to agree."""


class Step(NamedTuple):
    """A clock was set between two samples: index of the first sample after it, and by how much, seconds."""

    row: int
    by_s: float


def stamp_resolution_s(path: Samples) -> float:
    """Return what stamps are rounded to, seconds; 0 where they are not, or where it cannot be seen."""
    return resolution_s(path.stamps_ns)


def even_stamps(path: Samples) -> Samples:
    """Return the samples with rounded stamps of a regular publisher put back on its even grid; others as they are."""
    rounded_s = stamp_resolution_s(path)
    if not rounded_s:
        return path
    said = f"stamps are rounded to {rounded_s * 1e3:g} ms: a clock that is off by less than half of that cannot be seen"
    even = evened(path.stamps_ns)
    if even is None:
        return path.noted(said)
    return path.stamped(even).noted(f"{said}; they were spaced evenly")


def clock_steps(path: Samples) -> list[Step]:
    """Return where the clock of the stamps was set, by samples in the order of their arrival and the times of it.

    There the stamps jump and the times of arrival do not, and it lasts: a message that is late, or lost, is none.
    """
    if len(path.log_ns) != len(path) or len(path) < 2 * _LEAST or not path.stamps_ns.all():
        return []
    ahead = (path.stamps_ns - path.log_ns).astype(np.float64) * 1e-9
    interval = np.diff(path.stamps_ns) * 1e-9
    usual_s = float(np.median(interval))
    jump = np.diff(ahead)
    found: list[Step] = []
    for i in np.flatnonzero((np.abs(jump) > _STEP_S[0]) & (np.abs(jump) < _STEP_S[1])):
        before, after = ahead[max(i + 1 - _BESIDE, 0) : i + 1], ahead[i + 1 : i + 1 + _BESIDE]
        if min(len(before), len(after)) < _LEAST:
            continue
        by_s = float(np.median(after) - np.median(before))
        lasts = abs(by_s) > _STEP_S[0] and abs(by_s - jump[i]) < _ALIKE * abs(by_s)
        stamped = abs(interval[i] - usual_s - by_s) < _ALIKE * abs(by_s) + usual_s
        calm = float(np.median(np.abs(before - np.median(before))) + np.median(np.abs(after - np.median(after))))
        if lasts and stamped and calm < _ALIKE * abs(by_s):
            found.append(Step(int(i) + 1, by_s))
    return found


def between_steps(path: Samples) -> list[Samples]:
    """Return the samples before, between and after the steps of their clock, in the order of arrival."""
    steps = clock_steps(path)
    if not steps:
        return [path]
    start = int(path.stamps_ns[0])
    where = ", ".join(f"{s.by_s:+.3f} s at {(path.stamps_ns[s.row - 1] - start) * 1e-9:.1f} s" for s in steps)
    path = path.noted(f"its clock was set while recording ({where}): what lies between has a clock of its own")
    edges = [0, *(s.row for s in steps), len(path)]
    parts = [path.only(np.arange(a, b)) for a, b in pairwise(edges)]
    return [part for part in parts if len(part) > _LEAST]

"""Rounded stamps, and steps of a clock during a recording.

Drivers and loggers round stamps to milliseconds or to hundredths of a second, which hides clock offsets of less than
half of that. A network time daemon that steps a clock shifts all later stamps: they jump relative to the log times,
which remain even. The parts before and after a step have different clocks.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.geometry.rounded_stamps import evened, resolution_s
from odomcorrupt.geometry.se2 import wrap
from odomcorrupt.study.io.segments import GAP_S, GAP_STEPS

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["Step", "between_steps", "clock_steps", "even_stamps", "stamp_resolution_s"]

_LEAST_S, _BACK_S, _FORWARD_S = 0.02, 1.0, 3600.0
"""Smallest clock step that is detected, and the largest back and forward: what is larger is cut out by `time_order`."""
_NEIGHBOURS, _MIN_NEIGHBOURS = 25, 10
"""Samples on each side of a step that are compared, and the fewest of them."""
_TIMES = 2.0
"""Samples for this many times the step are compared if more: messages that queued while a recorder was blocked, and
then lost ones, look like a step for as long as they queued."""
_BESIDE = 5
"""Intervals on each side of a gap in which the robot has to move steadily at a regular rate, if there are no log times:
localisation has no such rate, because it waits for motion."""
_TOLERANCE = 0.3
"""Relative tolerance between a step of a single stamp and of the medians around it."""


class Step(NamedTuple):
    """A step of a clock: index of the first sample after it, and its size in seconds."""

    row: int
    by_s: float


def stamp_resolution_s(path: Samples) -> float:
    """Return the resolution of the stamps, seconds; 0 if they are not rounded or it cannot be determined."""
    return resolution_s(path.stamps_ns)


def even_stamps(path: Samples) -> Samples:
    """Return the samples with rounded stamps of a periodic publisher restored to an even grid; others unchanged."""
    rounded_s = stamp_resolution_s(path)
    if not rounded_s:
        return path
    said = f"stamps are rounded to {rounded_s * 1e3:g} ms: a clock that is off by less than half of that cannot be seen"
    even = evened(path.stamps_ns)
    if even is None:
        return path.noted(said)
    return path.stamped(even).noted(f"{said}; they were spaced evenly")


def clock_steps(path: Samples) -> list[Step]:
    """Return the steps of the stamps' clock, from samples in order of arrival.

    At a step the stamps jump permanently and the log times do not; late or lost messages are not steps. Without log
    times of their own, stamps step forward where a moving robot travels what it travels in one interval.
    """
    if len(path) < 2 * _MIN_NEIGHBOURS or not path.stamps_ns.all():
        return []
    interval = np.diff(path.stamps_ns) * 1e-9
    usual_s = float(np.median(interval))
    if len(path.log_ns) != len(path) or np.array_equal(path.log_ns, path.stamps_ns):
        return [] if path.localised else _steps_of_motion(path, interval, usual_s)
    ahead = (path.stamps_ns - path.log_ns).astype(np.float64) * 1e-9
    jump = np.diff(ahead)
    found: list[Step] = []
    for i in np.flatnonzero((np.abs(jump) > _LEAST_S) & (jump > -_BACK_S) & (jump < _FORWARD_S)):
        count = max(_NEIGHBOURS, round(_TIMES * abs(jump[i]) / max(usual_s, 1e-3)))
        before, after = ahead[max(i + 1 - count, 0) : i + 1], ahead[i + 1 : i + 1 + count]
        if min(len(before), len(after)) < _MIN_NEIGHBOURS:
            continue
        by_s = float(np.median(after) - np.median(before))
        lasts = abs(by_s) > _LEAST_S and abs(by_s - jump[i]) < _TOLERANCE * abs(by_s)
        stamped = abs(interval[i] - usual_s - by_s) < _TOLERANCE * abs(by_s) + usual_s
        calm = float(np.median(np.abs(before - np.median(before))) + np.median(np.abs(after - np.median(after))))
        if lasts and stamped and calm < _TOLERANCE * abs(by_s):
            found.append(Step(int(i) + 1, by_s))
    return found


def _steps_of_motion(path: Samples, interval: Array, usual_s: float) -> list[Step]:
    """Return the steps forward of a clock where a path goes on at its speed as if no time had passed."""
    with np.errstate(all="ignore"):  # positions and headings are not checked yet
        gone = np.linalg.norm(np.diff(path.xyz[:, :2], axis=0), axis=1)
        motions = np.stack((gone, np.abs(wrap(np.diff(path.yaw_rad)))) if path.headed else (gone,), axis=1)
    found: list[Step] = []
    for i in np.flatnonzero((interval > max(GAP_S, GAP_STEPS * usual_s)) & (interval < _FORWARD_S)):
        rows = np.r_[max(i - _BESIDE, 0) : i, i + 1 : i + 1 + _BESIDE] % len(motions)
        beside, regular = motions[rows], np.all(np.abs(interval[rows] - usual_s) < _TOLERANCE * usual_s)
        steady = (beside.min(axis=0) > 0.5 * beside.max(axis=0)) & (motions[i] < 1.5 * beside.mean(axis=0))
        if regular and _BESIDE <= i < len(motions) - _BESIDE and steady.any():
            found.append(Step(int(i) + 1, float(interval[i]) - usual_s))
    return found


def between_steps(path: Samples) -> list[Samples]:
    """Return the samples in order of arrival, split at the steps of their clock."""
    steps = clock_steps(path)
    if not steps:
        return [path]
    start = int(path.stamps_ns[0])
    where = ", ".join(f"{s.by_s:+.3f} s at {(path.stamps_ns[s.row - 1] - start) * 1e-9:.1f} s" for s in steps)
    path = path.noted(f"its clock was set while recording ({where}): what lies between has a clock of its own")
    edges = [0, *(s.row for s in steps), len(path)]
    parts = [path.only(np.arange(a, b)) for a, b in pairwise(edges)]
    return [part for part in parts if len(part) > _MIN_NEIGHBOURS] or [path]

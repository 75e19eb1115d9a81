"""Stamps that are not when poses were taken: rounded ones, and clocks that are set while recording.

Drivers and loggers cut stamps to milliseconds, or to hundredths of a second: an offset of less than half of that is no
clock's. A network time daemon that steps a clock shifts all stamps from there on: against the recorder's own times,
which go on evenly, the stamps jump, and what lies before and after has a clock of its own.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["Step", "between_steps", "clock_steps", "even_stamps", "stamp_resolution_s"]

_ROUNDED_NS = (100_000_000, 50_000_000, 20_000_000, 10_000_000, 5_000_000, 2_000_000, 1_000_000)
_ALL = 0.999
"""Part of the stamps that are multiples of what they are rounded to."""
_USUAL = 1.5
"""Intervals longer than so many times the usual one are gaps."""
_VARY = 0.02
"""Part of the intervals that differ from the usual one where rounding shows: in a regular clock's they do not."""
_EVEN_OVER, _WITHIN, _FITS = 101, 0.6, 0.99
"""Samples over which a publisher keeps its rate, and how far stamps are off an even grid, in parts of what they are
rounded to, nearly all of them."""
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
    """Return what stamps are rounded to, seconds; 0 where they are not, or where it cannot be seen.

    Stamps of a clock that ticks regularly lie on a grid without being rounded: intervals have to vary on it.
    """
    whole = next((r for r in _ROUNDED_NS if np.mean(path.stamps_ns % r == 0) >= _ALL), 0)
    steps = np.diff(path.stamps_ns)
    if not whole or not len(steps):
        return 0.0
    usual = steps[steps < _USUAL * np.median(steps) + whole]
    varied = float(np.mean(usual != np.median(usual))) > _VARY
    return whole * 1e-9 if varied else 0.0


def even_stamps(path: Samples) -> Samples:
    """Return the samples with rounded stamps of a regular publisher put back on its even grid; others as they are."""
    rounded_s = stamp_resolution_s(path)
    if not rounded_s:
        return path
    said = f"stamps are rounded to {rounded_s * 1e3:g} ms: a clock that is off by less than half of that cannot be seen"
    even = _evened(path.stamps_ns, rounded_s)
    if even is None:
        return path.noted(said)
    return path.stamped(even).noted(f"{said}; they were spaced evenly")


def _evened(stamps_ns: NDArray[np.int64], rounded_s: float) -> NDArray[np.int64] | None:
    """Return stamps (n,) on an even grid that slowly changes, None where they are farther off it than rounding does."""
    if len(stamps_ns) < 2 * _EVEN_OVER:
        return None
    t_s = (stamps_ns - stamps_ns[0]).astype(np.float64) * 1e-9
    steps = np.diff(t_s)
    usual = steps[steps < _USUAL * np.median(steps) + rounded_s]
    period_s = float(np.mean(usual))
    if period_s < 2.0 * rounded_s:
        return None
    count = np.concatenate(([0.0], np.cumsum(np.maximum(np.round(steps / period_s), 1.0))))
    off = t_s - count * period_s
    half = _EVEN_OVER // 2
    # reflected about its ends, a line stays one
    padded = np.concatenate((2.0 * off[0] - off[half:0:-1], off, 2.0 * off[-1] - off[-2 : -half - 2 : -1]))
    smooth = np.convolve(padded, np.full(_EVEN_OVER, 1.0 / _EVEN_OVER), "valid")
    if np.mean(np.abs(off - smooth) < _WITHIN * rounded_s) < _FITS:
        return None
    even = stamps_ns[0] + np.round((count * period_s + smooth) * 1e9).astype(np.int64)
    return even if np.all(np.diff(even) > 0) else None


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

"""Rounded stamps, stamps of a pose's arrival instead of its measurement, and steps of a clock during a recording.

Rounding hides clock offsets of less than half of it. A daemon that steps a clock shifts all later stamps relative to
the log times; the parts before and after have different clocks. Stamps of arrival vary in their intervals while steps
do not; so do poses published after a fixed travel, so the other path, interpolated at these stamps, tells whether the
speed really changed.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.geometry.se2 import wrap
from odomcorrupt.geometry.trajectory import evened, resolution_s
from odomcorrupt.study.io.localisation import is_localised
from odomcorrupt.study.io.segments import GAP_S, GAP_STEPS

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

_LEAST_S, _BACK_S, _FORWARD_S = 0.02, 1.0, 3600.0
"""Smallest detected clock step and largest backward and forward ones, s; `time_order` handles larger ones."""
_NEIGHBOURS, _MIN_NEIGHBOURS = 25, 10
"""Samples on each side of a step that are compared, and the fewest of them."""
_TIMES = 2.0
"""Least time span compared on each side, as a multiple of the step: messages that queued in a blocked recorder,
followed by lost ones, look like a step for as long as they queued."""
_BESIDE = 5
"""Intervals of steady motion at a regular rate required on each side of a gap, if there are no log times; localisation
has no regular rate, because it waits for motion."""
_MOST_STEPS = 10
"""Most steps of a clock; more jumps of the stamps are those of messages that come in bursts."""
_TOLERANCE = 0.3
"""Relative tolerance between a step of a single stamp and of the medians around it."""


class Step(NamedTuple):
    """A step of a clock: index of the first sample after it, and its size in seconds."""

    row: int
    by_s: float


def even_stamps(path: Samples) -> Samples:
    """Return the samples with rounded stamps of a periodic publisher restored to an even grid; others unchanged."""
    rounded_s = resolution_s(path.stamps_ns)
    if not rounded_s:
        return path
    said = f"stamps are rounded to {rounded_s * 1e3:g} ms: a clock that is off by less than half of that cannot be seen"
    even = evened(path.stamps_ns)
    return path.noted(said) if even is None else path.stamped(even).noted(f"{said}; they were spaced evenly")


def clock_steps(path: Samples) -> list[Step]:
    """Return the steps of the stamps' clock, from samples in order of arrival.

    At a step the stamps jump permanently and the log times do not; late or lost messages are not steps. Without
    separate log times, a forward step is a gap in which a moving robot travels only as far as in one interval.
    """
    if len(path) < 2 * _MIN_NEIGHBOURS or not path.stamps_ns.all():
        return []
    interval = np.diff(path.stamps_ns) * 1e-9
    usual_s = float(np.median(interval))
    if len(path.log_ns) != len(path) or np.array_equal(path.log_ns, path.stamps_ns):
        return [] if is_localised(path) else _steps_of_motion(path, interval, usual_s)
    ahead = (path.stamps_ns - path.log_ns).astype(np.float64) * 1e-9
    jump = np.diff(ahead) - np.median(np.diff(ahead))  # a clock of another rate or unit makes no steps
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
    """Return forward clock steps: gaps of the stamps in which a robot in steady motion travels one usual interval.

    No gap is a step if the robot hardly moves in as many others: the publisher then waits for motion.
    """
    with np.errstate(all="ignore"):  # positions and headings are not checked yet
        gone = np.linalg.norm(np.diff(path.xyz[:, :2], axis=0), axis=1)
        motions = np.stack((gone, np.abs(wrap(np.diff(path.yaw_rad)))) if path.headed else (gone,), axis=1)
        usual = np.percentile(motions, 80.0, axis=0)
    found, waits = list[Step](), 0
    for i in np.flatnonzero((interval > max(GAP_S, GAP_STEPS * usual_s)) & (interval < _FORWARD_S)):
        rows = np.r_[max(i - _BESIDE, 0) : i, i + 1 : i + 1 + _BESIDE] % len(motions)
        beside, regular = motions[rows], np.all(np.abs(interval[rows] - usual_s) < _TOLERANCE * usual_s)
        mean = beside.mean(axis=0)
        steady = (beside.min(axis=0) > 0.5 * beside.max(axis=0)) & (np.abs(motions[i] - mean) < 0.5 * mean)
        if regular and _BESIDE <= i < len(motions) - _BESIDE and steady.any():
            found.append(Step(int(i) + 1, float(interval[i]) - usual_s))
        else:
            waits += bool((motions[i] <= 1.5 * usual).all())
    return found if waits < len(found) else []


def between_steps(path: Samples) -> list[Samples]:
    """Return the samples in order of arrival, split at the steps of their clock."""
    steps = clock_steps(path)
    if not 0 < len(steps) <= _MOST_STEPS:
        return [path]
    start = int(path.stamps_ns[0])
    where = ", ".join(f"{s.by_s:+.3f} s at {(path.stamps_ns[s.row - 1] - start) * 1e-9:.1f} s" for s in steps)
    path = path.noted(f"its clock was set while recording ({where}): each part has its own clock")
    edges = [0, *(s.row for s in steps), len(path)]
    parts = [path.only(np.arange(a, b)) for a, b in pairwise(edges)]
    return [part for part in parts if len(part) > _MIN_NEIGHBOURS] or [path]


_WINDOW = 21
"""Samples over which the speed is assumed constant."""
_MOVING_MPS = 0.1
_MIN_SAMPLES = 200
_MIN_JITTER_S = 2e-3
"""Smallest jitter reported: it corresponds to one or two millimetres of motion."""
_MIN_RATIO, _SIGMAS = 0.5, 4.0
"""Steps over intervals vary with ratio 1 if stamps are right; jitter is reported below 0.5, by 4 standard errors."""
_GAP_STEPS = 3.0


def jitter_warnings(path: Samples, off_s: float) -> list[str]:
    """Return a warning if a path's stamps jitter (`off_s` > 0), because a fit would count it as noise of each step."""
    if not off_s:
        return []
    seen = "the intervals between them vary, the steps between its poses do not"
    what = "the learned noise includes that; stamp poses when they are measured"
    return [f"{path.name}: its stamps are off by about {off_s * 1e3:.2g} ms each ({seen}), and {what}"]


def stamp_jitter_s(path: Samples, other: Samples) -> float:
    """Return the standard deviation of the stamps' jitter, seconds; 0 if the poses follow their stamps."""
    interval_s = np.diff(path.stamps_ns) * 1e-9
    if len(interval_s) < _MIN_SAMPLES:
        return 0.0
    usual_s, (usual_m, varies_m) = _running_mean(interval_s), _steps(path.xyz[:, :2])
    speed = usual_m / np.maximum(usual_s, 1e-9)
    used = (speed > _MOVING_MPS) & (interval_s < _GAP_STEPS * np.median(interval_s))
    used[: _WINDOW // 2] = used[-(_WINDOW // 2) :] = False
    if used.sum() < _MIN_SAMPLES:
        return 0.0
    varies_s = interval_s - usual_s
    off_s = float(np.std(varies_s[used])) / np.sqrt(2.0)
    there = other.trajectory().at(path.t_s, int(path.stamps_ns[0]))[:, :2]
    expected_m = (speed * varies_s)[used]
    if off_s < _MIN_JITTER_S or _follow(varies_m[used], expected_m):
        return 0.0
    return off_s if _follow(_steps(there)[1][used], expected_m) else 0.0


def _steps(xy: Array) -> tuple[Array, Array]:
    """Return the length (n,), m, of the running mean step of a path, and the excess of each step over it, m.

    Steps are projected on the mean direction, because noise makes every step longer, but not its projection.
    """
    step = np.diff(xy, axis=0)
    mean = np.stack([_running_mean(part) for part in step.T], axis=1)
    usual_m = np.linalg.norm(mean, axis=1)
    return usual_m, np.sum(step * mean, axis=1) / np.maximum(usual_m, 1e-12) - usual_m


def _follow(steps_m: Array, expected_m: Array) -> bool:
    """Return whether deviations of steps (n,) may be at least half of the expected deviations (n,)."""
    square = float(expected_m @ expected_m)
    share = float(expected_m @ steps_m) / square
    error = float(np.std(steps_m - share * expected_m)) / float(np.sqrt(square))
    return share + _SIGMAS * error >= _MIN_RATIO


def _running_mean(values: Array) -> Array:
    """Return the running mean (n,) over `_WINDOW` values."""
    return np.convolve(values, np.full(_WINDOW, 1.0 / _WINDOW), "same")

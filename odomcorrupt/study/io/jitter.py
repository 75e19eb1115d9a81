"""Detection of stamps that mark a pose's arrival instead of its measurement: intervals vary but steps do not.

Poses that are published after a fixed travel look the same. The other path, interpolated at these stamps, tells
whether the speed really changed: odometry at the truth's stamps, or truth at the odometry's.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["jitter_warnings", "stamp_jitter_s"]

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
    what = "what is learned as noise holds that, too; stamp poses when they are taken"
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
    there = other.trajectory().at(path.seconds_since(int(path.stamps_ns[0])), int(path.stamps_ns[0]))[:, :2]
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
    mean: Array = np.convolve(values, np.full(_WINDOW, 1.0 / _WINDOW), "same")
    return mean

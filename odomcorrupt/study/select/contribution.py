"""Contribution: how far each part of a model moves the odometry beside the error that is left; whether it matters.

A test says whether an effect is there, and with a good truth and a long drive a hundredth of any effect is. Whether it
matters is another question: a part is negligible where the model without it (the rest refitted) leaves about the same
error. The two paths differ by a distance that no noise of the truth enters; the error, with which it is compared, does
contain that noise, so that less than the truth can show never counts as large.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, isfinite
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import FitError
from odomcorrupt.geometry.se2 import between
from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.estimate.windows import distance_windows, time_windows
from odomcorrupt.study.io.clock import aligned
from odomcorrupt.study.io.headings import with_recomputed_headings

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.io.clock import Clock
    from odomcorrupt.study.io.recording import Recording, Trajectory
    from odomcorrupt.study.select.decisions import Practical

__all__ = ["FAR_M", "Contribution", "Span", "contributions"]

FAR_M = 50.0
"""Length of path after which slow causes show, as a bias does that hardly moves anything in 10 s, m."""
_PHASES = np.arange(5) / 5.0
_WHOLE = 0.9
"""Part of its length that a window has to have."""


@dataclass(frozen=True, slots=True)
class Span:
    """What a part does over windows of one length.

    moved_m : root mean square distance between the ends of the odometry corrected with and without it
    error_m : root mean square error of the model with it
    travelled_m : root mean square length of path
    """

    moved_m: float
    error_m: float
    travelled_m: float

    @property
    def share(self) -> float:
        """By which part of it the error would grow without the part of the model, were both independent."""
        return hypot(1.0, self.moved_m / max(self.error_m, 1e-12)) - 1.0

    def negligible(self, share: float, per_m: float) -> bool:
        """Return whether the error would grow by less than a share, or the part moves less than so much per metre."""
        return self.share < share or self.moved_m < per_m * self.travelled_m


@dataclass(frozen=True, slots=True)
class Contribution:
    """What one part of a model does to the odometry within 10 s, and over 50 m of path where a window is so long."""

    ten_seconds: Span
    far: Span | None

    def negligible(self, practical: Practical) -> bool:
        """Return whether it matters at neither length."""
        if not self.ten_seconds.negligible(practical.share, practical.per_m):
            return False
        return self.far is None or self.far.negligible(practical.far_share, practical.per_m)


def contributions(
    fitted: Fit, recordings: Sequence[Recording] = (), clocks: Sequence[Clock] = ()
) -> dict[str, Contribution]:
    """Return what each systematic part of a fitted model does, by name; nothing where no window is whole.

    Parameters
    ----------
    fitted : the model; it is refitted without each part
    recordings, clocks : what to measure on, such as recordings that were not fitted; default the fitted ones
    """
    problem = fitted.problem
    pairs = zip(recordings or problem.recordings, clocks or problem.clocks, strict=True)
    on_time = [recording for recording in (aligned(r, c) for r, c in pairs) if recording.positioned]
    if not fitted.effects or not on_time:
        return {}
    windows = [_windows(on_time, None), _windows(on_time, FAR_M)]
    left = _left(on_time, fitted)
    found = {}
    for effect in fitted.effects:
        others = [other for other in fitted.effects if other is not effect]
        try:
            bare = _left(on_time, fitted.refit(others, weights=fitted.noise.weights))
        except FitError:  # what holds a fit together matters
            continue
        near, far = (_span(left, bare, one) for one in windows)
        if near is not None:
            found[effect.name] = Contribution(near, far)
    return found


def _left(recordings: Sequence[Recording], fitted: Fit) -> list[Recording]:
    return [with_recomputed_headings(undo(recording, fitted.effects)) for recording in recordings]


def _windows(recordings: Sequence[Recording], distance_m: float | None) -> list[Array]:
    """Return the ends (n, 2) of windows of each recording at five phases, s: of a length of path, or of 10 s."""
    found = []
    for one in recordings:
        cuts = [
            time_windows(one, phase=phase) if distance_m is None else distance_windows(one, distance_m, phase)
            for phase in _PHASES
        ]
        ends = np.concatenate([np.stack((cut.start_s, cut.end_s), axis=1) for cut in cuts])
        # the last window of a length of path ends with the drive
        found.append(ends if distance_m is None else ends[_travelled(one, ends) > _WHOLE * distance_m])
    return found


def _travelled(recording: Recording, ends: Array) -> Array:
    """Return the length of path (n,) of windows (n, 2), m."""
    steps = np.linalg.norm(np.diff(recording.odometry.xyt[:, :2], axis=0), axis=1)
    path = np.interp(ends, recording.odometry_s, np.concatenate(([0.0], np.cumsum(steps))))
    metres: Array = path[:, 1] - path[:, 0]
    return metres


def _moves(path: Trajectory, ends: Array, origin_ns: int) -> Array:
    """Return where a path gets to in each window, (n, 2) m in the frame of its start."""
    first, last = (path.at(at_s, origin_ns) for at_s in ends.T)
    return between(first, last)[:, :2]


def _span(left: Sequence[Recording], bare: Sequence[Recording], windows: Sequence[Array]) -> Span | None:
    """Return what a part does: the recordings corrected with it and without it; None where no window is whole."""
    every = list(zip(left, bare, windows, strict=True))
    if not any(len(ends) for ends in windows):
        return None
    whole = np.concatenate([_moves(one.odometry, ends, one.origin_ns) for one, _, ends in every])
    without = np.concatenate([_moves(other.odometry, ends, other.origin_ns) for _, other, ends in every])
    truth = np.concatenate([_moves(one.truth, ends, one.origin_ns) for one, _, ends in every])
    metres = np.concatenate([_travelled(one, ends) for one, _, ends in every])
    sizes = (_rms(whole - without), _rms(whole - truth), float(np.sqrt(np.mean(metres**2))))
    return Span(*sizes) if all(map(isfinite, sizes)) else None


def _rms(vectors: Array) -> float:
    return float(np.sqrt(np.mean(np.sum(vectors**2, axis=1))))

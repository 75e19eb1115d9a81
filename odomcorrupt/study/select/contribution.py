"""Contribution: displacement of the odometry by each part of a model, compared with the error of the model.

With an accurate truth and a long drive, effects of a hundredth of their usual size are significant. Practical relevance
is another question: a part is negligible if the model without it (the rest refitted) has about the same error. The
distance between the paths of the two models is free of truth noise. The error contains that noise, so a displacement
below the accuracy of the truth never counts as large.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import hypot, isfinite
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import FitError
from odomcorrupt.geometry.se2 import between
from odomcorrupt.geometry.trajectory import distance_along
from odomcorrupt.study.estimate.problem import undo
from odomcorrupt.study.estimate.windows import WINDOW_S, distance_windows, time_windows
from odomcorrupt.study.io.clock import aligned
from odomcorrupt.study.io.headings import with_recomputed_headings
from odomcorrupt.study.io.recording import shared_frame

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.motion import Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.study.estimate.gauss_newton import Fit
    from odomcorrupt.study.io.clock import Clock
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.select.decisions import Practical

FAR_M = 50.0
"""Length of path, m, at which slow causes are measured, such as a bias with hardly any influence in 10 s."""
_PHASES = np.arange(5) / 5.0  # starts of the first window, as fractions of a window
_WHOLE = 0.9
"""Least length of a window, as a fraction of the nominal length."""


@dataclass(frozen=True, slots=True)
class Span:
    """Contribution of a part of a model over windows of one length.

    moved_m : root mean square distance between the ends of the odometry corrected with and without the part, m
    error_m : root mean square error of the odometry corrected with it, m
    travelled_m : root mean square length of path, m
    """

    moved_m: float
    error_m: float
    travelled_m: float

    @property
    def share(self) -> float:
        """Relative growth of the error without the part, if the two are independent."""
        return hypot(1.0, self.moved_m / max(self.error_m, 1e-12)) - 1.0

    def unpredicted(self, misfit: float) -> float:
        """Return the squared error that a model neither predicts nor removes, in units of that of the part.

        misfit : ratio of measured to predicted errors
        """
        beyond = self.error_m**2 * (1.0 - misfit**-2.0)
        return max(beyond / max(self.moved_m, 1e-12) ** 2, (self.error_m / max(self.travelled_m, 1e-12)) ** 2)

    def negligible(self, share: float, per_m: float) -> bool:
        """Return whether the growth is below `share`, or the displacement below `per_m` metres per metre of path."""
        return self.share < share or self.moved_m < per_m * self.travelled_m


@dataclass(frozen=True, slots=True)
class Contribution:
    """Contribution of one part of a model over 10 s, and over 50 m of path (None if no window is that long)."""

    ten_seconds: Span
    far: Span | None

    def negligible(self, practical: Practical) -> bool:
        """Return whether the part is negligible at both lengths."""
        if not self.ten_seconds.negligible(practical.share, practical.per_m):
            return False
        return self.far is None or self.far.negligible(practical.far_share, practical.per_m)


def is_exact(error_m: float, motions: Sequence[Motion], practical: Practical) -> bool:
    """Return whether an error after 10 s is negligible beside the travel in that time, as of a simulator's odometry."""
    travelled_m = sum(float(np.sum(m.travel)) for m in motions)
    duration_s = sum(float(np.sum(m.dt_s)) for m in motions)
    return error_m < practical.per_m * WINDOW_S * travelled_m / max(duration_s, 1e-9)


def contributions(
    fitted: Fit, recordings: Sequence[Recording] = (), clocks: Sequence[Clock] = ()
) -> dict[str, Contribution]:
    """Return the contribution of each systematic part of a fitted model, by name; empty if no window is complete.

    fitted : the model; it is refitted without each part
    recordings, clocks : recordings to measure on, such as held-out ones, and their clocks; default the fitted ones, as
        for recordings in another frame if the model has effects of places
    """
    problem = fitted.problem
    frames = {shared_frame(recordings), shared_frame(problem.recordings)} if recordings else ()
    if len(frames) > 1 and any(effect.reads_places for effect in fitted.effects):
        recordings, clocks = (), ()
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
            bare = _left(on_time, fitted.refit(others, weights_of=fitted))
        except FitError:  # no fit without this part, so no contribution can be computed
            continue
        near, far = (_span(left, bare, one) for one in windows)
        if near is not None:
            found[effect.name] = Contribution(near, far)
    return found


def _left(recordings: Sequence[Recording], fitted: Fit) -> list[Recording]:
    return [with_recomputed_headings(undo(recording, fitted.effects)) for recording in recordings]


def _windows(recordings: Sequence[Recording], distance_m: float | None) -> list[Array]:
    """Return begin and end (n, 2) of the windows of each recording, s, at five phases: by length of path, or 10 s."""
    found = []
    for one in recordings:
        cuts = [
            time_windows(one, phase=phase) if distance_m is None else distance_windows(one, distance_m, phase)
            for phase in _PHASES
        ]
        ends = np.concatenate([np.stack((cut.start_s, cut.end_s), axis=1) for cut in cuts])
        # the last window may be short, because it ends with the drive
        found.append(ends if distance_m is None else ends[_travelled(one, ends) > _WHOLE * distance_m])
    return found


def _travelled(recording: Recording, ends: Array) -> Array:
    """Return the length of path (n,) of windows (n, 2), m."""
    path = np.interp(ends, recording.odometry_s, distance_along(recording.odometry.xyt))
    return path[:, 1] - path[:, 0]


def _displacements(path: Trajectory, ends: Array, origin_ns: int) -> Array:
    """Return the displacement (n, 2) of a path over each window, m, in the frame of the pose at its start."""
    first, last = (path.at(at_s, origin_ns) for at_s in ends.T)
    return between(first, last)[:, :2]


def _span(left: Sequence[Recording], bare: Sequence[Recording], windows: Sequence[Array]) -> Span | None:
    """Return the contribution of a part from recordings corrected with and without it; None without any window."""
    every = list(zip(left, bare, windows, strict=True))
    if not any(len(ends) for ends in windows):
        return None
    whole = np.concatenate([_displacements(one.odometry, ends, one.origin_ns) for one, _, ends in every])
    without = np.concatenate([_displacements(other.odometry, ends, other.origin_ns) for _, other, ends in every])
    truth = np.concatenate([_displacements(one.truth, ends, one.origin_ns) for one, _, ends in every])
    metres = np.concatenate([_travelled(one, ends) for one, _, ends in every])
    apart = whole - without, whole - truth, metres[:, None]
    sizes = [float(np.sqrt(np.mean(np.sum(vectors**2, axis=1)))) for vectors in apart]
    return Span(*sizes) if all(map(isfinite, sizes)) else None

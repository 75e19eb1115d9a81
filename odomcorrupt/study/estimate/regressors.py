"""Smooth motion of a run, from the odometry or from the truth, on which the regressors are computed.

An error can be regressed only on a motion that does not contain it. On a real robot encoders are smooth, and contact
with the ground disturbs the true motion: the odometry is used. Odometry that was corrupted by this package or by a
simulator contains the noise of every sample: the truth is used. The jitter of the odometry decides.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, NamedTuple, Self

import numpy as np

from odomcorrupt.effects.effect import Motion
from odomcorrupt.geometry.motion import SMOOTHING_S, LocalSlopes, motion_of, speed_steps
from odomcorrupt.geometry.se2 import increments
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.io.clock import aligned, coarse_clock

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Recording

Side = Literal["odometry", "truth"]

TRUTH_SMOOTHING_S = (0.5, 2.0)
"""Least and largest smoothing window of the truth: as short as its noise allows, because it blurs starts and stops."""
_HEADING_S = 20.0
"""Window, s, over which the odometry's headings are corrected by those of the truth: it turns by about a degree less or
more in that time."""
_SLOPE_NOISE = np.array([0.003, 0.003, 0.002])
"""Noise allowed in a smoothed speed, m/s and rad/s; more would look like motion of a robot at rest."""
_JITTER_S = 0.2  # least time step for estimates of the odometry's noise, s
_SIDEWAYS = 0.1
"""Least fraction of the travelled distance that a holonomic robot moves sideways."""
_BIAS, _BLIND_BIAS = 2e-4, 0.002
"""Relative bias of a gain above which the truth is used; the same beside positions alone."""
_NOISE_RATIO, _ERRORS = 3.0, 3.0
"""Least noise of the odometry in terms of the smoothed truth's, and in standard errors, so that it is the noisier."""
_FEW = 50  # least number of samples in motion
_CLIP = 5.0
"""Multiple of the median roughness above which a sample is a start or stop, and a difference of the sides a jump."""


def drives_sideways(motions: Sequence[Motion]) -> bool:
    """Return whether a robot drives sideways; a small sideways speed is an artefact of smoothing."""
    along = sum(float(np.abs(m.v * m.dt_s).sum()) for m in motions)
    across = sum(float(np.abs(m.vy * m.dt_s).sum()) for m in motions)
    return across > _SIDEWAYS * along


class MotionSmoother:
    """Smooth motions of a run over the odometry's intervals, also for odometry with effects removed (same stamps).

    The motions serve regressors and noise laws only; their composition is not exact.

    stretches : recorded stretches of one run, on the truth's clock: each has the odometry from the beginning of the
        run, and the truth of its own time
    side : the poses of which speeds are local slopes, "odometry" or "truth"
    like : smoother of the same run at another offset of its clock, with which the odometry's own motion is shared
    """

    def __init__(self, stretches: Sequence[Recording], side: Side, like: MotionSmoother | None = None) -> None:
        self.stretches, self._side = tuple(stretches), side
        self.recording = whole = max(stretches, key=lambda r: len(r.odometry))
        self.odometry: _Odometry = like.odometry if like is not None else _Odometry(whole)
        if not self.odometry.is_of(whole):
            self.odometry = _Odometry(whole)
        t_s = whole.odometry_s
        self._ends_s, self._dt_s, middle = t_s[1:], self.odometry.motion.dt_s, (t_s[:-1] + t_s[1:]) / 2.0
        # Slopes and patches of the floor are fixed in the world, so places come from the truth: where intervals begin,
        # as in corruption, with the mean heading.
        begins, means = (
            [
                (stretch.truth, _within(stretch.truth, part, whole.origin_ns))
                for stretch, part in _by_truth(self.stretches, at_s)
            ]
            for at_s in (t_s[:-1], middle)
        )
        at = np.concatenate([path.at(part, whole.origin_ns) for path, part in begins])
        self._x, self._y = np.ascontiguousarray(at[:, 0]), np.ascontiguousarray(at[:, 1])
        headings = [path.heading_at(part, whole.origin_ns) for path, part in means]
        if side == "odometry":
            own = np.split(whole.odometry.heading_at(middle, whole.origin_ns), np.cumsum([*map(len, headings)])[:-1])
            measured = [(r.truth_s[0] <= t) & (t <= r.truth_s[-1]) for r, t in _by_truth(self.stretches, middle)]
            parts = [part for _, part in means]
            headings = [_without_noise(*each) for each in zip(headings, own, parts, measured, strict=True)]
        self._theta = np.concatenate(headings)
        if side == "odometry":
            self._slopes = [self.odometry.slopes]
        else:
            self._slopes = [
                _Slopes.of(stretch.truth, part, whole.origin_ns, _truth_window(stretch.truth))
                for stretch, part in _by_truth(self.stretches, middle)
            ]
        self._cuts = np.cumsum([len(slopes.left) for slopes in self._slopes])[:-1]

    @property
    def raw(self) -> Motion:
        """Motion of the unchanged odometry, not smoothed."""
        return replace(self.odometry.motion, t_s=self._ends_s)

    @cached_property
    def recorded(self) -> Motion:
        """Smooth motion of the unchanged recording."""
        return self._motion(*self.odometry.smooth) if self._side == "odometry" else self.motion(self.recording)

    def motion(self, recording: Recording) -> Motion:
        """Return the smooth motion of the recording with other odometry at the same stamps."""
        if self._side == "odometry":
            twist = self._slopes[0].twist(recording.odometry)
        else:
            twist = np.concatenate([part.twist(part.path) for part in self._slopes])
        parts = zip(self._slopes, np.split(twist, self._cuts), strict=True)
        return self._motion(twist, np.concatenate([slopes.lines.accelerations(part) for slopes, part in parts]))

    def _motion(self, twist: Array, acceleration: Array) -> Motion:
        v, vy, omega = np.ascontiguousarray(twist.T)
        return Motion(
            t_s=self._ends_s,
            dt_s=self._dt_s,
            v=v,
            vy=vy,
            omega=omega,
            acceleration=acceleration,
            x=self._x,
            y=self._y,
            theta=self._theta,
            distance=np.cumsum(np.hypot(twist[:, 0], twist[:, 1]) * self._dt_s),
            track_m=self.recording.track_m,
            # speeds of the truth add up to no phase of a wheel
            reported=None if self._side == "odometry" else self.odometry.reported,
            steps=self.odometry.steps,
        )


class _Odometry:
    """Motion of a run's recorded odometry, which is the same to the bit at any offset of its clock."""

    def __init__(self, recording: Recording) -> None:
        self._recording, self._begin_ns = recording, int(recording.odometry.stamps_ns[0])
        self._t_s = recording.odometry.seconds_since(self._begin_ns)

    def is_of(self, recording: Recording) -> bool:
        """Return whether a recording has this odometry, its stamps at most shifted."""
        own, other = self._recording.odometry, recording.odometry
        alike = len(own) == len(other) and self._recording.track_m == recording.track_m
        return alike and bool(np.ptp(own.stamps_ns - other.stamps_ns) == 0) and np.array_equal(own.xyt, other.xyt)

    @cached_property
    def motion(self) -> Motion:
        """Motion over the intervals, not smoothed, at times since the first stamp."""
        return motion_of(self._t_s, self._recording.odometry.xyt, track_m=self._recording.track_m)

    @cached_property
    def steps(self) -> tuple[float, float] | None:
        """Steps of the reported speeds, if they are multiples of any."""
        made = self.motion
        return speed_steps(made.v, made.omega, made.dt_s, self._recording.track_m)

    @cached_property
    def reported(self) -> Array:
        """Travel, m, and turn, rad, so far (n, 2)."""
        steps = increments(self._recording.odometry.xyt)
        return np.cumsum(np.stack((steps.ds_m, steps.dtheta_rad), axis=1), axis=0)

    @cached_property
    def slopes(self) -> _Slopes:
        """Line fits to the poses at the middle of each interval."""
        return _Slopes.of(self._recording.odometry, (self._t_s[:-1] + self._t_s[1:]) / 2.0, self._begin_ns, SMOOTHING_S)

    @cached_property
    def smooth(self) -> tuple[Array, Array]:
        """Smooth twists and accelerations (n, 3) of the intervals."""
        twist = self.slopes.twist(self._recording.odometry)
        return twist, self.slopes.lines.accelerations(twist)


@dataclass(frozen=True, slots=True)
class _Slopes:
    """Line fits to the poses of a path at given times, and the position of these times among its stamps."""

    path: Trajectory
    lines: LocalSlopes
    left: NDArray[np.int64]
    fraction: Array

    @classmethod
    def of(cls, path: Trajectory, at_s: Array, origin_ns: int, width_s: float) -> Self:
        """Return the fits to a path at times (m,), s, in windows of a given width, s."""
        left, fraction = path.place_of(_within(path, at_s, origin_ns), origin_ns)
        return cls(path, LocalSlopes(path.seconds_since(origin_ns), at_s, width_s), left, fraction)

    def twist(self, path: Trajectory) -> Array:
        """Return the twist (m, 3) of a path with the same stamps."""
        return self.lines.twist(path.xyt, path.headings_between(self.left, self.fraction))


def _without_noise(truth: Array, odometry: Array, t_s: Array, measured: NDArray[np.bool_]) -> Array:
    """Return headings (n,) with the odometry's turns, whose slow deviation from the truth's headings is removed.

    A regressor that contained the truth's turns would contain its noise, and the error of the odometry that is to be
    explained.

    measured : (n,) whether a time is between the first and the last truth; other times have the nearest deviation
    """
    if not measured.any():
        return truth
    at_s, t_s = t_s, t_s[measured]
    apart = np.unwrap((truth - odometry)[measured])
    first, last = np.searchsorted(t_s, (t_s - _HEADING_S / 2.0, t_s + _HEADING_S / 2.0))
    summed = np.concatenate(([0.0], np.cumsum(apart)))
    return odometry + np.interp(at_s, t_s, (summed[last] - summed[first]) / (last - first))


def _by_truth(stretches: Sequence[Recording], at_s: Array) -> list[tuple[Recording, Array]]:
    """Return the stretches of a run in order of time, each with those of ascending times (m,) nearest to its truth."""
    ordered = sorted(stretches, key=lambda r: int(r.truth.stamps_ns[0]))
    ends = [r.truth_s[[0, -1]] for r in ordered]
    between = [(before[1] + after[0]) / 2.0 for before, after in pairwise(ends)]
    return list(zip(ordered, np.split(at_s, np.searchsorted(at_s, between)), strict=True))


def _within(path: Trajectory, at_s: Array, origin_ns: int) -> Array:
    """Return times (m,), s, with those before and after a path replaced by its ends."""
    own = path.seconds_since(origin_ns)
    return np.clip(at_s, own[0], own[-1])


def truth_noise(truth: Trajectory) -> Array:
    """Return the standard deviation (3,) of the truth's white noise, m and rad, from its second differences."""
    rough = np.diff(np.nan_to_num(truth.xyt), n=2, axis=0)
    noise: Array = np.sqrt(np.median(rough**2, axis=0) / 0.4549 / 6.0)  # 0.4549 is the median of chi-square with 1
    return noise


def _truth_window(truth: Trajectory) -> float:
    """Return the window, s, for which the truth's white noise causes slope errors of `_SLOPE_NOISE`."""
    rate = 1.0 / float(np.median(np.diff(truth.stamps_ns)) * 1e-9)
    # the slope of a line through N samples in a window T has the standard deviation sqrt(12 / N) noise / T
    windows = (truth_noise(truth) * np.sqrt(12.0 / rate) / _SLOPE_NOISE) ** (2.0 / 3.0)
    return float(np.clip(windows.max(), *TRUTH_SMOOTHING_S))


def choose_side(recording: Recording, node_s: float) -> Side:
    """Return the side with the smaller bias by its own noise in a regression of gains; by default the odometry.

    Noise of variance q per second in a regressor of speed v biases a gain by q / (v^2 node_s). A bias below `_BIAS` is
    negligible; above it the truth is used, if the odometry is significantly noisier than the smoothed truth. The noise
    is estimated from second differences of increments over 0.2 s, which cancel smooth driving and hardly contain ticks.
    """
    t_s = recording.odometry_s
    grid = np.arange(t_s[0], t_s[-1], max(_JITTER_S, 2.0 * float(np.median(np.diff(t_s)))))
    step = _steps(recording.odometry, grid, recording.origin_ns)
    moving = np.hypot(step[:, 0], step[:, 1])[1:-1] > 1e-3
    # motion interpolated between the sweeps of a laser is too smooth to show the odometry's noise
    if recording.matched or moving.sum() < _FEW:
        return "odometry"
    # the lower bound prevents 0 / 0 in a channel without motion, whose noise is zero too
    per_noise = (grid[1] - grid[0]) / node_s / np.maximum((step**2).mean(axis=0), 1e-30)
    if (found := _noise(recording, moving, grid)) is None:
        rough = np.diff(step, n=2, axis=0)[moving]
        square = np.minimum(rough**2, 9.0 * np.median(rough**2, axis=0) + 1e-15)
        return "truth" if (square.mean(axis=0) / 6.0 * per_noise > _BLIND_BIAS).any() else "odometry"
    noisy = found.odometry > np.maximum(_NOISE_RATIO * found.truth, _ERRORS * found.error)
    return "truth" if (noisy & (found.odometry * per_noise > _BIAS)).any() else "odometry"


def _steps(path: Trajectory, grid: Array, origin_ns: int) -> Array:
    """Return travel and turn (n, 2) between successive times of a grid, m and rad."""
    steps = increments(path.at(grid, origin_ns))
    return np.stack((steps.ds_m, steps.dtheta_rad), axis=1)


class _Noise(NamedTuple):
    """Noise variances (2,) of travel and turn, m^2 and rad^2.

    odometry, error : of a step of the odometry, and its standard error
    truth : of a step with as much noise as remains in the truth's smoothed speeds
    """

    odometry: Array
    error: Array
    truth: Array


def _noise(recording: Recording, moving: NDArray[np.bool_], grid: Array) -> _Noise | None:
    """Return the noise of both sides; None if the truth has no headings or too few samples.

    Roughness that both sides share is motion, such as speed oscillations of motors: the noise of one side is
    uncorrelated with the other side, so that the mean product of both estimates the shared part.
    """
    seen = aligned(recording, coarse_clock(recording))
    truth_s = seen.truth.seconds_since(recording.origin_ns)
    chosen = moving & (grid[:-3] >= truth_s[0]) & (grid[3:] <= truth_s[-1])
    own = np.diff(_steps(seen.odometry, grid, recording.origin_ns), n=2, axis=0)[chosen]
    other = np.diff(_steps(seen.truth, grid, recording.origin_ns), n=2, axis=0)[chosen]
    if len(own) < _FEW or not np.isfinite(other).all():
        return None
    # starts and stops are left out, and differences clipped on both sides: an upper bound on one side alone would turn
    # motion into noise of the other
    bound = _CLIP * np.median(np.abs(own), axis=0)
    kept = np.abs(own) <= bound
    own, differs = np.where(kept, own, 0.0), np.where(kept, other - own, 0.0)
    limit = _CLIP * np.array([np.median(np.abs(d[k])) for d, k in zip(differs.T, kept.T, strict=True)])
    differs = np.clip(differs, -limit, limit)
    count = kept.sum(axis=0)
    alone, of_truth = -own * differs / 6.0, (own + differs) * differs / 6.0
    white = np.where(kept, _white(seen.truth, grid, recording.origin_ns)[chosen] / 6.0, 0.0)
    white = np.minimum(white, limit**2 / 6.0).sum(axis=0) / count
    coloured = np.maximum(of_truth.sum(axis=0) / count - white, 0.0)
    return _Noise(
        odometry=alone.sum(axis=0) / count,
        error=alone.std(axis=0) * np.sqrt(len(own)) / count,
        truth=coloured + _remaining(seen.truth, grid) * white,
    )


def _white(truth: Trajectory, grid: Array, origin_ns: int) -> Array:
    """Return squared roughness (n, 2) by the truth's white noise, in which even and odd samples differ."""
    even, odd = (Trajectory(truth.stamps_ns[i::2], truth.xyt[i::2]) for i in (0, 1))
    apart = np.diff(_steps(even, grid, origin_ns) - _steps(odd, grid, origin_ns), n=2, axis=0)
    return apart**2 / 2.0


def _remaining(truth: Trajectory, grid: Array) -> float:
    """Return the fraction of the truth's white noise that biases a gain as the odometry's noise of a step does.

    Of samples with variance s^2 every d seconds, the slope in a window w and the pose difference over it have the
    covariance 12 s^2 d / w^2 per second. Second differences of steps between interpolated poses show 20/6 * 2/3 s^2.
    """
    every_s = float(np.median(np.diff(truth.stamps_ns))) * 1e-9
    return min(5.4 * every_s * float(grid[1] - grid[0]) / _truth_window(truth) ** 2, 1.0)

"""What drives the regressors: the smooth motion of a run, taken from the odometry or from the truth.

An error can be regressed only on a motion that does not contain it. The encoder of a real robot is smooth and the
contact with the ground disturbs the truth: take the odometry. Odometry that was made noisy by us (or by a simulator)
carries the noise itself, sample by sample: take the truth then. The odometry's own jitter shows which it is.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Literal, NamedTuple, Self

import numpy as np

from odomcorrupt.effects.effect import Motion
from odomcorrupt.geometry.increments import increments
from odomcorrupt.geometry.motion import SMOOTHING_S, LineFits
from odomcorrupt.geometry.se2 import rotate
from odomcorrupt.study.io.clock import aligned, coarse_clock

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Recording, Trajectory

__all__ = ["MotionSmoother", "Side", "choose_side", "drives_sideways", "driving_motion", "truth_noise"]

Side = Literal["odometry", "truth"]

TRUTH_SMOOTHING_S = (0.5, 2.0)
"""Least and largest window for the truth: as short as its noise allows, because starts and stops are blurred by it."""
_SLOPE_NOISE = np.array([0.003, 0.003, 0.002])
"""Noise left in a driving speed, m/s and rad/s: more of it would pass for motion while the robot does not move so."""
_JITTER_S = 0.2
_SIDEWAYS = 0.1
"""Part of the travelled distance that a holonomic robot moves sideways, at least."""
_BIAS = 0.002
_LEAST_BIAS, _PLAIN_SIDE = 2e-4, 3.0
_FEW = 50
_SHARED, _PLAINLY = 0.7, 3.0
"""Roughness of which the truth shows less than this part, beyond so many standard errors, is the odometry's own."""


def drives_sideways(motions: Sequence[Motion]) -> bool:
    """Tell whether a robot can drive sideways; a differential one's sideways speed is an artefact of smoothing."""
    along = sum(float(np.abs(m.v * m.dt_s).sum()) for m in motions)
    across = sum(float(np.abs(m.vy * m.dt_s).sum()) for m in motions)
    return across > _SIDEWAYS * along


class MotionSmoother:
    """Smooth motions over the odometry's intervals, whatever effects are taken out of it: its stamps stay the same.

    They are for regressors and noise laws alone: they cannot be composed exactly.

    Parameters
    ----------
    stretches : of one run, as they were recorded, on the truth's clock: the odometry of each is that of the run from
        its beginning, and where the robot was in its time is its truth's to say
    side : of which side's poses the speeds are local slopes

    """

    def __init__(self, stretches: Sequence[Recording], side: Side) -> None:
        self.stretches, self._side = tuple(stretches), side
        self.recording = whole = max(stretches, key=lambda r: len(r.odometry))
        t_s = whole.odometry_s
        self._ends_s, self._dt_s, middle = t_s[1:], np.diff(t_s), (t_s[:-1] + t_s[1:]) / 2.0
        # slopes and regions lie in the world
        shared = _by_truth(self.stretches, middle)
        at = np.concatenate([_where(stretch.truth, part, whole.origin_ns) for stretch, part in shared])
        self._x, self._y, self._theta = np.ascontiguousarray(at.T)
        if side == "odometry":
            shared, widths_s = [(whole, middle)], [SMOOTHING_S]
        else:
            widths_s = [_truth_window(stretch.truth) for stretch, _ in shared]
        self._slopes = [
            _Slopes.of(stretch.odometry if side == "odometry" else stretch.truth, part, whole.origin_ns, width_s)
            for (stretch, part), width_s in zip(shared, widths_s, strict=True)
        ]
        parts = zip((part for _, part in shared), widths_s, strict=True)
        self._speeds = [LineFits(part, part, width_s) for part, width_s in parts]
        self._cuts = np.cumsum([len(part) for _, part in shared])[:-1]

    @cached_property
    def recorded(self) -> Motion:
        """The smooth motion of the recording as it was recorded."""
        return self.motion(self.recording)

    def motion(self, recording: Recording) -> Motion:
        """Return the smooth motion of the recording with other odometry at the same stamps."""
        twist = self._twist(recording)
        v, vy, omega = np.ascontiguousarray(twist.T)
        return Motion(
            t_s=self._ends_s,
            dt_s=self._dt_s,
            v=v,
            vy=vy,
            omega=omega,
            acceleration=self._accelerations(twist),
            x=self._x,
            y=self._y,
            theta=self._theta,
            distance=np.cumsum(np.hypot(twist[:, 0], twist[:, 1]) * self._dt_s),
            track_m=recording.track_m,
        )

    def acceleration(self, recording: Recording) -> Array:
        """Return the acceleration (n, 3) of `motion` alone."""
        return self._accelerations(self._twist(recording))

    def _accelerations(self, twist: Array) -> Array:
        parts = np.split(twist, self._cuts)
        return np.concatenate([fits.slopes(part) for fits, part in zip(self._speeds, parts, strict=True)])

    def _twist(self, recording: Recording) -> Array:
        if self._side == "odometry":
            return self._slopes[0].twist(recording.odometry)
        return np.concatenate([part.twist(part.path) for part in self._slopes])


@dataclass(frozen=True, slots=True)
class _Slopes:
    """Line fits to the poses of a path at some times, and where on the path these times are."""

    path: Trajectory
    lines: LineFits
    left: NDArray[np.int64]
    fraction: Array

    @classmethod
    def of(cls, path: Trajectory, at_s: Array, origin_ns: int, width_s: float) -> Self:
        """Return the fits to a path at times (m,), in windows of a width."""
        own = path.seconds_since(origin_ns)
        left, fraction = path.place_of(np.clip(at_s, own[0], own[-1]), origin_ns)
        return cls(path, LineFits(own, at_s, width_s), left, fraction)

    def twist(self, path: Trajectory) -> Array:
        """Return the twist (m, 3) of a path with the same stamps."""
        world = self.lines.slopes(path.xyt)
        heading = path.headings_between(self.left, self.fraction)
        return np.concatenate((rotate(world[:, :2], -heading), world[:, 2:]), axis=1)


def _by_truth(stretches: Sequence[Recording], at_s: Array) -> list[tuple[Recording, Array]]:
    """Return the stretches of a run in order, and of growing times (m,) those that are nearest to the truth of each."""
    ordered = sorted(stretches, key=lambda r: int(r.truth.stamps_ns[0]))
    ends = [r.truth.seconds_since(r.origin_ns)[[0, -1]] for r in ordered]
    between = [(before[1] + after[0]) / 2.0 for before, after in pairwise(ends)]
    return list(zip(ordered, np.split(at_s, np.searchsorted(at_s, between)), strict=True))


def _where(path: Trajectory, at_s: Array, origin_ns: int) -> Array:
    """Return the poses (m, 3) of a path at times (m,), of its ends beyond them."""
    own = path.seconds_since(origin_ns)
    return path.at(np.clip(at_s, own[0], own[-1]), origin_ns)


def driving_motion(recording: Recording, side: Side) -> Motion:
    """Return the motion over the odometry's intervals, speeds being local slopes of the poses of one side."""
    return MotionSmoother([recording], side).recorded


def truth_noise(truth: Trajectory) -> Array:
    """Return the deviation (3,) of the truth's white noise, m and rad: second differences cancel smooth driving."""
    rough = np.diff(np.nan_to_num(truth.xyt), n=2, axis=0)
    noise: Array = np.sqrt(np.median(rough**2, axis=0) / 0.4549 / 6.0)  # 0.4549 is the median of chi-square with 1
    return noise


def _truth_window(truth: Trajectory) -> float:
    """Return the window (s) in which the truth's white noise leaves `_SLOPE_NOISE` of a slope."""
    rate = 1.0 / float(np.median(np.diff(truth.stamps_ns)) * 1e-9)
    # a line through N samples in a window T has a slope of deviation sqrt(12 / N) noise / T
    windows = (truth_noise(truth) * np.sqrt(12.0 / rate) / _SLOPE_NOISE) ** (2.0 / 3.0)
    return float(np.clip(windows.max(), *TRUTH_SMOOTHING_S))


def choose_side(recording: Recording, node_s: float) -> Side:
    """Return the side whose own noise would bias a regression of gains the less, the odometry unless it is plainly bad.

    Noise of variance q per second inside a regressor of speed v biases a gain by q / (v^2 node_s). Below `_BIAS` nobody
    sees it; above, the truth drives. Second differences of increments over 0.2 s show the odometry's own noise with its
    full size (smooth driving cancels, ticks hardly count), and clipping passes over starts and stops. What the truth
    shows, too, is no noise: motors hunt, and on a drive that hardly turns that is all the turning there is.

    Where all the noise there is plainly lives in the odometry, a tenth of that is enough: on straights, where there
    is no motion beside it, a basis function would find it.
    """
    t_s = recording.odometry_s
    grid = np.arange(t_s[0], t_s[-1], max(_JITTER_S, 2.0 * float(np.median(np.diff(t_s)))))
    step = _steps(recording.odometry, grid, recording.origin_ns)
    moving = np.hypot(step[:, 0], step[:, 1])[1:-1] > 1e-3
    if moving.sum() < _FEW:
        return "odometry"
    rough = np.diff(step, n=2, axis=0)[moving]
    square = np.minimum(rough**2, 9.0 * np.median(rough**2, axis=0) + 1e-15)
    # a drive that never turns has no noise of turns either
    per_noise = (grid[1] - grid[0]) / node_s / np.maximum((step**2).mean(axis=0), 1e-30)
    noisy = square.mean(axis=0) / 6.0 * per_noise > _BIAS
    shared = _shared(recording, moving, grid)
    if shared is None:
        return "truth" if noisy.any() else "odometry"
    noisy &= shared.part + _PLAINLY * shared.error < _SHARED
    lives_here = shared.odometrys > _PLAIN_SIDE * np.maximum(shared.truths, 0.0)
    lives_here &= shared.odometrys > _PLAINLY * shared.noise_error
    noisy |= lives_here & (shared.odometrys * per_noise > _LEAST_BIAS)
    return "truth" if noisy.any() else "odometry"


def _steps(path: Trajectory, grid: Array, origin_ns: int) -> Array:
    """Return travel and turn (n, 2) from one time of a grid to the next."""
    steps = increments(path.at(grid, origin_ns))
    return np.stack((steps.ds_m, steps.dtheta_rad), axis=1)


class _Shared(NamedTuple):
    """Of travel and turn (2,): which part of the odometry's roughness the truth has, too, and what is each one's own.

    part, error : and its standard error
    odometrys, truths : variance of a step that is noise of the one alone
    noise_error : standard error of the odometry's
    """

    part: Array
    error: Array
    odometrys: Array
    truths: Array
    noise_error: Array


def _shared(recording: Recording, moving: NDArray[np.bool_], grid: Array) -> _Shared | None:
    """Return what the sides' roughness has in common; None where the truth has no headings or too little is seen.

    Noise of either side is in one of the factors alone, so their mean product is what they have in common. A truth
    with no such difference is too noisy as regressor; one without headings is not tested.
    """
    seen = aligned(recording, coarse_clock(recording))
    truth_s = seen.truth.seconds_since(recording.origin_ns)
    chosen = moving & (grid[:-3] >= truth_s[0]) & (grid[3:] <= truth_s[-1])
    own = np.diff(_steps(seen.odometry, grid, recording.origin_ns), n=2, axis=0)[chosen]
    other = np.diff(_steps(seen.truth, grid, recording.origin_ns), n=2, axis=0)[chosen]
    if len(own) < _FEW or not np.isfinite(other).all():
        return None
    bound = 5.0 * np.median(np.abs(own), axis=0)
    own = np.clip(own, -bound, bound)
    common, whole = own * other, np.maximum((own**2).mean(axis=0), 1e-30)
    other = np.clip(other, -bound, bound)
    alone = (own**2 - own * other) / 6.0
    return _Shared(
        part=common.mean(axis=0) / whole,
        error=common.std(axis=0) / np.sqrt(len(common)) / whole,
        odometrys=alone.mean(axis=0),
        truths=(other**2 - own * other).mean(axis=0) / 6.0,
        noise_error=alone.std(axis=0) / np.sqrt(len(alone)),
    )

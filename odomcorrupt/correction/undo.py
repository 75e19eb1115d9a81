"""Removal of learned effects from a trajectory: the inverse of a corruption, the bias at rest, corrections of poses.

Source: Foxlin 2005, Pedestrian tracking with shoe-mounted inertial sensors (zero-velocity updates); Rauch, Tung and
Striebel 1965 (smoother).

Between two pose updates the output of a filter that fuses poses (as robot_localization) follows wheels and gyro;
at an update it steps. Wheels never step sideways: their sideways speed is zero, or changes slowly because of inertia if
the robot drives sideways. Without the steps the errors of wheels and gyro accumulate as in free odometry, so that a
model of them can be learned and corrected.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from odomcorrupt.corruption.path import JUMP_MIN_S, JUMP_SPEED
from odomcorrupt.effects.compensation import corrected_increments, corrected_twist
from odomcorrupt.effects.effect import Effect, Kind, Motion
from odomcorrupt.effects.random_processes import GyroBiasWalk
from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.motion import is_rough, motion_of
from odomcorrupt.geometry.se2 import Increments, accumulate, compose, increments, rotate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array


REST_S, SETTLED_S = 0.6, 0.15
"""Shortest rest that is read, and the part at either end that is left out, because the body sways on its wheels."""


class Readings(NamedTuple):
    """Mean yaw rates (k,) of k rests, rad/s, with their variances, at times (k,) after the start, s."""

    rate: Array
    variance: Array
    t_s: Array


def bias_seen_at_rest(effects: Sequence[Effect], motion: Motion, omega: Array) -> Array:
    """Return the gyro's bias (n,), rad/s: read in rests, smoothed as a `gyro_bias_walk` between them; zero without one.

    effects : of the model
    motion : of the odometry, n intervals
    omega : (n,) yaw rates after the removal of systematic effects, rad/s
    """
    walk = next((effect for effect in effects if isinstance(effect, GyroBiasWalk) and effect.acts), None)
    readings = _readings(motion, omega)
    if walk is None or not len(readings.t_s):
        return np.zeros(len(motion))
    readings = _without_turns(walk, readings)
    return _between(walk, readings.t_s, _smoothed(walk, readings), np.cumsum(motion.dt_s) - motion.dt_s / 2.0)


def _readings(motion: Motion, omega: Array) -> Readings:
    """Return the mean yaw rate of each rest."""
    # speed below which wheels stand, m/s: less than a tick of usual encoders per message
    still = np.hypot(motion.v, motion.vy) < 1e-3
    # yaw rate beyond which a robot without travel turns on the spot; the bias of a MEMS gyro is below 0.02 rad/s
    still &= (np.abs(omega) < 0.05) & (motion.dt_s > 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], still, [False])).astype(int)))
    ends_s = np.concatenate(([0.0], np.cumsum(motion.dt_s)))
    found = []
    for first, last in edges.reshape(-1, 2).tolist():
        begin_s, end_s = ends_s[first], ends_s[last]
        if end_s - begin_s < REST_S:
            continue
        inner = slice(*np.searchsorted(ends_s, (begin_s + SETTLED_S, end_s - SETTLED_S)).tolist())
        rates, dt_s = omega[inner], motion.dt_s[inner]
        if len(rates) > 1:
            found.append((np.average(rates, weights=dt_s), np.var(rates) / len(rates), (begin_s + end_s) / 2.0))
    return Readings(*np.array(found).reshape(-1, 3).T)


def _without_turns(walk: GyroBiasWalk, readings: Readings) -> Readings:
    """Return the readings without those that differ from what both neighbours predict: slow turns on the spot."""
    if len(readings.t_s) < 3:
        return readings
    rate, variance, t_s = readings
    before, after = np.diff(t_s)[:-1], np.diff(t_s)[1:]
    share = after / (before + after)  # of the earlier neighbour
    predicted = share * rate[:-2] + (1.0 - share) * rate[2:]
    bridge = walk.density**2 * before * after / (before + after)
    allowed = variance[1:-1] + share**2 * variance[:-2] + (1.0 - share) ** 2 * variance[2:] + bridge
    off = np.concatenate(([0.0], (rate[1:-1] - predicted) ** 2 / np.maximum(allowed, 1e-18), [0.0]))
    most = np.maximum(np.concatenate((off[1:], [0.0])), np.concatenate(([0.0], off[:-1])))
    # difference from the neighbouring readings, in standard deviations, beyond which a robot turned slowly instead
    kept = (off <= 5.0**2) | (off < most)
    return Readings(rate[kept], variance[kept], t_s[kept])


def _smoothed(walk: GyroBiasWalk, readings: Readings) -> Array:
    """Return the expected bias (k,) at each reading, given all of them."""
    keep, kick = walk.kept(np.diff(readings.t_s))
    means, variances, predicted = [], [], []
    # standard deviation of the bias before its first reading
    mean, variance = 0.0, 0.05**2
    for i, (rate, noise) in enumerate(zip(readings.rate.tolist(), readings.variance.tolist(), strict=True)):
        if i:
            mean, variance = keep[i - 1] * mean, keep[i - 1] ** 2 * variance + kick[i - 1]
        predicted.append((mean, variance))
        gain = variance / (variance + noise)
        mean, variance = mean + gain * (rate - mean), (1.0 - gain) * variance
        means.append(mean)
        variances.append(variance)
    for i in range(len(means) - 2, -1, -1):
        ahead, spread = predicted[i + 1]
        if spread > 0.0:
            means[i] += variances[i] * keep[i] / spread * (means[i + 1] - ahead)
    return np.array(means)


def _between(walk: GyroBiasWalk, t_s: Array, bias: Array, at_s: Array) -> Array:
    """Return the expected bias (n,) at times (n,), given that (k,) at the readings (k,)."""
    if not walk.tau:
        return np.interp(at_s, t_s, bias)
    after = np.searchsorted(t_s, at_s)
    low, high = np.maximum(after - 1, 0), np.minimum(after, len(t_s) - 1)
    since, until = (np.exp(-np.abs(at_s - t_s[side]) / walk.tau) for side in (low, high))
    whole = np.exp(-np.maximum(t_s[high] - t_s[low], 1e-9) / walk.tau)
    inside = (since * (1.0 - until**2) * bias[low] + until * (1.0 - since**2) * bias[high]) / (1.0 - whole**2)
    return np.where(low == high, since * bias[low], inside)


ROUNDS = 60
"""Iterations of the clock inversion: a clock is at most a tenth too fast, so each one gains a digit."""


@dataclass(frozen=True, slots=True)
class ClockInverse(Effect):
    """Inverse of clock effects: it shifts each stamp back by as much as they shifted it."""

    name: ClassVar[str] = "clock_inverse"
    kind: ClassVar[Kind] = "setup"
    summary: ClassVar[str] = "inverse of clock effects"
    clock: ClassVar[bool] = True

    clocks: tuple[Effect, ...] = ()

    @property
    def acts(self) -> bool:
        """Whether any clock effect acts."""
        return any(clock.acts for clock in self.clocks)

    def stamp_shift_s(self, t_s: Array) -> Array:
        """Return the shift (n,), seconds, for stamps that read t_s (n,) after the first one."""
        true_s = t_s.copy()
        for _ in range(ROUNDS):
            true_s = t_s - (self._shift_s(true_s) - self._shift_s(np.zeros(1)))
        return -self._shift_s(true_s)

    def _shift_s(self, t_s: Array) -> Array:
        shift_s: Array = np.zeros_like(t_s)
        for clock in self.clocks:
            shift_s = shift_s + clock.stamp_shift_s(t_s)
        return shift_s


def true_stamps(clocks: Sequence[Effect], stamps_ns: NDArray[np.int64], first_ns: int) -> NDArray[np.int64]:
    """Return the stamps (n,) of a correct clock; first_ns is the first stamp written by the wrong one."""
    right = ClockInverse(tuple(clocks))
    if not right.acts:
        return stamps_ns
    shift_s = right.stamp_shift_s((stamps_ns - first_ns) * np.float64(1e-9))
    return stamps_ns + np.rint(shift_s * 1e9).astype(np.int64)


MAX_ROUNDS = 100


@dataclass(frozen=True, slots=True)
class Undone:
    """Result of the removal for n poses.

    error_xyt : (n, 3) corrected minus measured, in odom axes, metres and radians
    driven : n - 1 corrected increments; zero across a jump of the pose
    driven_s : (n - 1,) durations of the increments, seconds
    jump : (n - 1,) whether the measured pose was reset there, instead of driven
    """

    error_xyt: Array
    driven: Increments
    driven_s: Array
    jump: NDArray[np.bool_]


def undo_effects(
    effects: Sequence[Effect], t_s: Array, measured_xyt: Array, track_m: float | None, *, frame_xyt: Array | None = None
) -> Undone:
    """Return the path of n poses with the effects removed; the first pose is unchanged.

    Nothing is driven across a jump of the pose, so the correction is constant there. The error is propagated instead of
    the path itself: without an acting effect, it is zero to the last bit.

    effects : any order
    t_s : (n,) ascending true times, seconds
    measured_xyt : (n, 3) measured poses in the odom frame, metres and radians
    track_m : nominal distance between the wheels, if known
    frame_xyt : (3,) pose of the odom frame in the frame of position-dependent effects; None if that is the odom frame
        itself

    Raises
    ------
    EffectError
        If no true motion explains the odometry.
    """
    frame_xyt = np.zeros(3) if frame_xyt is None else frame_xyt
    steps = increments(measured_xyt)
    dt_s = np.diff(t_s)
    world = np.diff(measured_xyt[:, :2], axis=0)
    jump = np.hypot(world[:, 0], world[:, 1]) > JUMP_SPEED * np.maximum(dt_s, JUMP_MIN_S)
    raw = steps.rows
    raw[jump] = 0.0
    driven_s = np.where(jump, 0.0, dt_s)
    smooth = accumulate(compose(frame_xyt, measured_xyt[0]), Increments.of_rows(raw))
    motion = replace(motion_of(t_s - t_s[0], smooth, track_m=track_m), dt_s=driven_s)
    before = motion.twist * driven_s[:, None]

    # without jumps the path determines the positions directly; across jumps they are found by iteration
    place = (
        compose(frame_xyt, measured_xyt[:-1]) if jump.any() and any(effect.reads_truth for effect in effects) else None
    )
    rough = _stays_rough(effects, motion, place)
    moving_s = np.where(driven_s > 0.0, driven_s, np.inf)
    for _ in range(MAX_ROUNDS):
        after = corrected_increments(effects, motion, place, rough=rough)
        turned = after.dtheta_rad - bias_seen_at_rest(effects, motion, after.dtheta_rad / moving_s) * driven_s
        added = np.stack((after.ds_m, after.dl_m, turned), axis=1) - before
        error = _error(raw, added, world, measured_xyt)
        found = compose(frame_xyt, (measured_xyt + error)[:-1])
        # convergence limit of the positions that effects depend on: largest change per iteration, metres or radians
        if place is None or np.abs(found - place).max(initial=0.0) <= 1e-10:
            return Undone(error, Increments.of_rows(raw + added), driven_s, jump)
        place = found
    raise EffectError(
        "position-dependent effects: cannot be removed from this odometry, the iteration of its positions does not "
        "converge"
    )


def _stays_rough(effects: Sequence[Effect], motion: Motion, place: Array | None) -> bool:
    """Tell whether odometry is rough, and rough still after the exact inversion: a real robot's, not a simulation's."""
    if not (any(effect.rectifies for effect in effects) and is_rough(motion.twist, motion.dt_s)):
        return False
    try:
        return is_rough(corrected_twist(effects, motion, place), motion.dt_s)
    except EffectError:
        return True


def _error(raw: Array, added: Array, world: Array, measured_xyt: Array) -> Array:
    """Return corrected minus measured poses (n, 3): the heading error rotates all later increments and jumps."""
    heading = np.concatenate(([0.0], np.cumsum(added[:, 2])))
    swing = heading[:-1] + added[:, 2] / 2.0
    middle = measured_xyt[:-1, 2] + raw[:, 2] / 2.0
    half = np.sin(swing / 2.0)
    less, s = -2.0 * half * half, np.sin(swing)  # cos(swing) - 1 without cancellation
    more = np.stack((less * world[:, 0] - s * world[:, 1], s * world[:, 0] + less * world[:, 1]), axis=1)
    shift = np.cumsum(more + rotate(added[:, :2], middle + swing), axis=0)
    return np.column_stack((np.concatenate((np.zeros((1, 2)), shift)), heading))


_LEAST_M = 2e-5
"""Least detection threshold, m: positions are written in micrometres, and single precision resolves 1e-6 at 10 m."""


class PoseCorrections(NamedTuple):
    """Number of filter steps in odometry, and the change (n, 3) of its poses by their removal, m and rad."""

    steps: int
    error_xyt: Array


def pose_corrections(t_s: Array, xyt: Array) -> PoseCorrections:
    """Return the sudden sideways steps of odometry and the change of the poses without them.

    The motion over a removed step is interpolated between its neighbours. Pose resets are kept, as in any correction.
    If steps are not much larger than the usual sideways motion, most of them are hidden, and none is removed.

    t_s : (n,) ascending times, seconds
    xyt : (n, 3) poses in the odom frame, metres and radians
    """
    steps, dt_s = increments(xyt), np.diff(t_s)
    moved = steps.rows
    driven = (dt_s > 0.0) & (np.hypot(moved[:, 0], moved[:, 1]) <= JUMP_SPEED * np.maximum(dt_s, JUMP_MIN_S))
    rows = np.flatnonzero(driven)
    if len(rows) < 3:
        return PoseCorrections(0, np.zeros_like(xyt))
    rate = moved[rows] / dt_s[rows, None]
    sideways = np.zeros(len(rows))
    sideways[1:-1] = np.abs(rate[1:-1, 1] - 0.5 * (rate[:-2, 1] + rate[2:, 1])) * dt_s[rows[1:-1]]
    beside = np.maximum(np.append(0.0, sideways[:-1]), np.append(sideways[1:], 0.0))
    # detection threshold as a multiple of the median sideways step: 6.7 standard deviations of normal ones
    least_m = max(_LEAST_M, 10.0 * float(np.median(sideways)))
    # a step raises the values of its two neighbours by half of its size
    sudden = (sideways > least_m) & (sideways >= beside)
    # least ratio of the median detected step to the threshold: of normally distributed steps one in ten is hidden then
    if not sudden.any() or np.median(sideways[sudden]) < 5.0 * least_m:
        return PoseCorrections(0, np.zeros_like(xyt))
    middle_s = 0.5 * (t_s[:-1] + t_s[1:])[rows]
    for column in range(3):
        rate[sudden, column] = np.interp(middle_s[sudden], middle_s[~sudden], rate[~sudden, column])
    moved[rows[sudden]] = rate[sudden] * dt_s[rows[sudden], None]
    free = accumulate(xyt[0], Increments.of_rows(moved))
    return PoseCorrections(int(sudden.sum()), free - np.column_stack((xyt[:, :2], np.unwrap(xyt[:, 2]))))

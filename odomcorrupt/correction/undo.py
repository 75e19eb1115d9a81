"""Removal of systematic errors from an odometry path: u = u' + f(u'), over the whole drive at once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from odomcorrupt.correction.bias_at_rest import bias_seen_at_rest
from odomcorrupt.corruption.path import JUMP_MIN_S, JUMP_SPEED
from odomcorrupt.effects.compensation import corrected_increments, corrected_twist
from odomcorrupt.effects.effect import Effect, Kind, Motion, State, TwistError
from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.increments import Increments, accumulate, increments
from odomcorrupt.geometry.motion import is_rough, motion_of
from odomcorrupt.geometry.se2 import compose, rotate

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

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

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f = 0: the effect moves stamps only."""
        return TwistError(np.zeros((len(motion), 3)), state)

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


PLACE_TOLERANCE = 1e-10
"""Convergence limit of the positions that effects depend on: largest change per iteration, metres or radians."""

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
    effects: Sequence[Effect],
    t_s: Array,
    measured_xyt: Array,
    track_m: float | None,
    *,
    frame_xyt: Array | None = None,
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
        if place is None or np.abs(found - place).max(initial=0.0) <= PLACE_TOLERANCE:
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

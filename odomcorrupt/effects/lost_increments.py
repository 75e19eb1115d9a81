"""Some increments never arrive."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import (
    About,
    Effect,
    Gain,
    Moments,
    Motion,
    Recorded,
    State,
    TwistError,
    parameter,
    stacked,
)
from odomcorrupt.effects.random_state import again

if TYPE_CHECKING:
    from numpy.random import Generator
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

_STILL = 1e-9
"""What an increment of zero may be by rounding, metres or radians."""
_MOVING_MPS = 0.05
_ARM_M = 0.2
"""How far wheels are from the middle, about: a turn on the spot moves them, too."""
_MOST_IN_A_ROW = 3
_LONGEST_S = 0.25
"""A longer rest may be a real stop."""
_CAUGHT_UP = 1.35
_OFTEN = 0.005
"""Part of increments that is lost alone, for two in a row to be likely at all."""


@dataclass(frozen=True, slots=True)
class LostIncrements(Effect):
    """Each increment is lost with probability `fraction`: the reported pose stands still while the robot goes on.

    On average it equals a scale error of the same size, but which increments are lost is random: it counts as
    noise. A correction that scaled the others up would miss what is seen plainly in the log: an increment of zero
    between neighbours that move, and is interpolated from these.
    """

    name = "lost_increments"
    kind = "noise"
    layer = "record"
    restorable = True
    summary = "some increments of the odometry are lost, with their travel"
    about = About(
        equation="reported increment = 0 with probability fraction",
        typical="0.1 to 5 % on a bad serial line (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("wheel_scale", "slip_burst"),
        drive="any: single increments of zero between neighbours that move, in the odometry alone",
    )

    fraction: float = parameter("", "part of the increments that is lost", low=0.0, high=0.9, typical=0.01)

    def start(self, rng: Generator) -> State:
        """Return what decides on losses."""
        return rng

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f = 0: what was reported is right, and nothing is known of the rest."""
        return TwistError(np.zeros((len(motion), 3)), state)

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - any time, any wheel
        """Return the increments with the lost ones zero."""
        rng = again(state)
        lost = rng.uniform(size=len(steps)) < self.fraction
        return Recorded(np.where(lost[:, None], 0.0, steps), rng)

    def restored(self, motion: Motion) -> Motion:
        """Return the motion with those that are plainly lost as fast as their neighbours."""
        gone = lost(motion)
        if not (self.acts and gone.any()):
            return motion
        middle = np.cumsum(motion.dt_s) - motion.dt_s / 2.0
        v, vy, omega = (
            np.where(gone, np.interp(middle, middle[~gone], speed[~gone]), speed)
            for speed in (motion.v, motion.vy, motion.omega)
        )
        return replace(motion, v=v, vy=vy, omega=omega)

    def moments(self, motion: Motion) -> Moments:
        """Return the mean loss and its variance."""
        twist = stacked(motion.v, motion.vy, motion.omega, motion.v)
        return Moments(self.fraction * twist, self.fraction * (1.0 - self.fraction) * twist**2)

    def gains(self, motion: Motion) -> tuple[Gain, ...]:
        """Return one chance per increment, which remembers nothing; the mean loss is no part of it."""
        twist = stacked(motion.v, motion.vy, motion.omega, motion.v)
        variance = self.fraction * (1.0 - self.fraction)
        return (Gain(twist, np.zeros_like(motion.v), np.full_like(motion.v, variance), 0.0),)


def moving(motion: Motion) -> NDArray[np.bool_]:
    """Return in which intervals (n,) the odometry reports a motion that it could not be mistaken about."""
    fast: NDArray[np.bool_] = np.hypot(motion.v, motion.vy) + _ARM_M * np.abs(motion.omega) > _MOVING_MPS
    return fast


def lost(motion: Motion) -> NDArray[np.bool_]:
    """Return which increments (n,) are zero, alone or a few in a row, between neighbours that move.

    A count that only came late is none of them: a neighbour catches up, and the two beside it go farther than those
    around them.
    """
    gone = np.zeros(len(motion), dtype=bool)
    still = (np.abs(motion.v) + np.abs(motion.vy) + np.abs(motion.omega)) * motion.dt_s < _STILL
    going = np.flatnonzero(~still)
    way = ((np.hypot(motion.v, motion.vy) + _ARM_M * np.abs(motion.omega)) * motion.dt_s)[going]
    fast = moving(motion)[going]
    last, following = going[1:-2], going[2:-1]
    gap = following - last - 1
    ends_s = np.cumsum(motion.dt_s)
    gap_s = ends_s[following - 1] - ends_s[last]
    alone = (gap == 1) | ((gap > 1) & (gap <= _MOST_IN_A_ROW) & (gap_s < _LONGEST_S))
    caught_up = way[1:-2] + way[2:-1] > _CAUGHT_UP * (way[:-3] + way[3:])
    found = alone & fast[1:-2] & fast[2:-1] & ~caught_up
    if np.sum(found & (gap == 1)) < _OFTEN * np.sum(fast):
        found &= gap == 1  # where hardly any is lost, several in a row are a stop
    for begin, count in zip(last[found], gap[found], strict=True):
        gone[begin + 1 : begin + 1 + count] = True
    return gone & (motion.dt_s > 0.0)  # a stamp that came twice lost nothing

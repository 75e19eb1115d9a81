"""Some increments never arrive."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

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
_BESIDE = 2
"""Increments on each side that say what a pair of neighbours would be if they had caught up nothing."""
_MANY = 1.5
"""A neighbour of a lost increment is more than so many ticks: two, of whole ones."""
_USUALLY, _ROUNDING_M = 0.8, 1e-7
"""Part of the changes between increments that are no larger than the usual one, and what is no change."""
_ALIKE = 1e-3
"""Part by which increments differ that are as long: a chord is shorter than its arc by a 24th of the turn squared."""


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
        gone = losses(motion).lost
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


class Losses(NamedTuple):
    """What an odometry shows of lost increments.

    lost : (n,) which increments are zero, alone or a few in a row, where they would have been many ticks
    seen : how many these are
    of : how many increments, lost or not, follow one after which a loss is seen
    hidden : part of the moving increments that are too few ticks for a loss to be seen
    """

    lost: NDArray[np.bool_]
    seen: int
    of: int
    hidden: float

    @property
    def fraction(self) -> float:
        """Part of the increments that is lost, of those a loss of which would be seen."""
        return self.seen / max(self.of, 1)


def losses(motion: Motion) -> Losses:
    """Return which increments of an odometry are lost.

    An increment of zero is a loss where both of its neighbours are plainly larger than what increments usually differ
    by: an encoder of coarse ticks reports zeros by itself, but none between increments of two ticks. A count that only
    came late is none: a neighbour catches up, and the two beside it go farther than those around them.
    """
    gone = np.zeros(len(motion), dtype=bool)
    arm_m = _ARM_M if motion.track_m is None else motion.track_m / 2.0
    travel = (np.hypot(motion.v, motion.vy) + arm_m * np.abs(motion.omega)) * motion.dt_s
    going = np.flatnonzero((np.abs(motion.v) + np.abs(motion.vy) + np.abs(motion.omega)) * motion.dt_s >= _STILL)
    way = travel[going]
    if len(going) < _BESIDE + 2:
        return Losses(gone, 0, 0, 0.0)
    fast = way > _MOVING_MPS * motion.dt_s[going]
    plain = fast & (way > _MANY * _usual_change(going, way))

    last, following = going[:-1], going[1:]
    gap = following - last - 1
    ends_s = np.cumsum(motion.dt_s)
    gap_s = ends_s[following - 1] - ends_s[last]
    alone = (gap == 1) | ((gap > 1) & (gap <= _MOST_IN_A_ROW) & (gap_s < _LONGEST_S))
    zero = alone & plain[:-1] & plain[1:]
    caught_up = zero & (way[:-1] + way[1:] > _CAUGHT_UP * 2.0 * _around(way))
    found = zero & ~caught_up
    if caught_up.sum() > found.sum():
        found[:] = False  # this odometry's counts come late: those that seem lost did, too
    if np.sum(found & (gap == 1)) < _OFTEN * np.sum(fast):
        found &= gap == 1  # where hardly any is lost, several in a row are a stop
    for begin, count in zip(last[found], gap[found], strict=True):
        gone[begin + 1 : begin + 1 + count] = True
    gone &= motion.dt_s > 0.0  # a stamp that came twice lost nothing

    arrived = int(np.sum(plain[:-1] & plain[1:] & ((gap == 0) | found)))
    hidden = 1.0 - float(plain.sum()) / max(int(fast.sum()), 1)
    return Losses(gone, int(gone.sum()), int(gone.sum()) + arrived, hidden)


def _usual_change(going: NDArray[np.int64], way: Array) -> float:
    """Return what an increment that moves usually differs by from the next one, metres, where it does: a tick.

    Where all are alike, starts and stops included, each is a tick itself: zeros come between two of them anyhow.
    """
    if np.ptp(way) < _ALIKE * way.max():
        return float(way.max())
    change = np.abs(np.diff(way))[np.diff(going) == 1]
    change = change[change > _ROUNDING_M]
    return float(np.quantile(change, _USUALLY)) if len(change) else 0.0


def _around(way: Array) -> Array:
    """Return the mean (n - 1,) of the increments around each pair of neighbours, the pair left out."""
    padded = np.concatenate((np.full(_BESIDE, way[0]), way, np.full(_BESIDE, way[-1])))
    total = np.convolve(padded, np.ones(2 * _BESIDE + 2), "valid")
    around: Array = (total[: len(way) - 1] - way[:-1] - way[1:]) / (2.0 * _BESIDE)
    return around

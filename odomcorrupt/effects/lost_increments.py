"""Random loss of single odometry increments."""

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
from odomcorrupt.effects.random_state import copied

if TYPE_CHECKING:
    from numpy.random import Generator
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

_STILL = 1e-9
"""Largest increment that counts as zero (rounding), metres or radians."""
_MOVING_MPS = 0.05
_ARM_M = 0.2
"""Assumed distance of the wheels from the middle if the track is unknown, metres: a turn on the spot moves them."""
_MOST_IN_A_ROW = 3
_LONGEST_S = 0.25
"""Longest gap that counts as a loss, seconds; a longer rest may be a real stop."""
_CAUGHT_UP = 1.35
_FREQUENT = 0.005
"""Rate of single losses above which losses of several increments in a row are plausible."""
_NEIGHBOURS = 2
"""Number of increments on each side whose mean is the expected size of a pair of neighbours."""
_LEAST_TICKS = 1.5
"""Smallest neighbour of a lost increment, in ticks: more than 1.5, i.e. two whole ticks."""
_USUAL_QUANTILE, _ROUNDING_M = 0.8, 1e-7
"""Quantile of the changes between increments taken as the usual change; change that counts as zero, metres."""


@dataclass(frozen=True, slots=True)
class LostIncrements(Effect):
    """Each increment is lost with probability `fraction`: the reported pose stops while the robot moves on.

    On average this equals a scale error of the same size, but which increments are lost is random: it counts as noise.
    A correction does not scale up the other increments. It interpolates lost ones, visible as an increment of zero
    between neighbours that move.
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
        """Return the random generator of the losses."""
        return rng

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f = 0: reported increments are correct, and the lost ones are not a function of the motion."""
        return TwistError(np.zeros((len(motion), 3)), state)

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - any time, any wheel
        """Return the increments with the lost ones set to zero."""
        rng = copied(state)
        lost = rng.uniform(size=len(steps)) < self.fraction
        return Recorded(np.where(lost[:, None], 0.0, steps), rng)

    def restored(self, motion: Motion) -> Motion:
        """Return the motion with the clearly lost increments interpolated between their neighbours."""
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
        """Return mean and variance of the loss."""
        twist = stacked(motion.v, motion.vy, motion.omega, motion.v)
        return Moments(self.fraction * twist, self.fraction * (1.0 - self.fraction) * twist**2)

    def gains(self, motion: Motion) -> tuple[Gain, ...]:
        """Return one independent coefficient per increment; the mean loss is not included."""
        twist = stacked(motion.v, motion.vy, motion.omega, motion.v)
        variance = self.fraction * (1.0 - self.fraction)
        return (Gain(twist, np.zeros_like(motion.v), np.full_like(motion.v, variance), 0.0),)


class Losses(NamedTuple):
    """Lost increments detected in an odometry.

    lost : (n,) True for increments of zero, single or a few in a row, that should have been several ticks
    seen : number of lost increments detected
    of : number of increments, lost or not, whose loss would have been detected
    hidden : fraction of the moving increments that have too few ticks for a loss to be detected
    """

    lost: NDArray[np.bool_]
    seen: int
    of: int
    hidden: float

    @property
    def fraction(self) -> float:
        """Fraction of increments lost, among those whose loss would have been detected."""
        return self.seen / max(self.of, 1)


def losses(motion: Motion) -> Losses:
    """Return the lost increments of an odometry.

    An increment of zero is a loss if both neighbours are clearly larger than the usual change between increments: an
    encoder of coarse ticks reports zeros, but none between increments of two ticks. A late count is not a loss: a
    neighbour catches up, so the two neighbours are longer than the increments around them.
    """
    gone = np.zeros(len(motion), dtype=bool)
    arm_m = _ARM_M if motion.track_m is None else motion.track_m / 2.0
    travel = (np.hypot(motion.v, motion.vy) + arm_m * np.abs(motion.omega)) * motion.dt_s
    going = np.flatnonzero((np.abs(motion.v) + np.abs(motion.vy) + np.abs(motion.omega)) * motion.dt_s >= _STILL)
    way = travel[going]
    if len(going) < _NEIGHBOURS + 2:
        return Losses(gone, 0, 0, 0.0)
    fast = way > _MOVING_MPS * motion.dt_s[going]
    plain = fast & (way > _LEAST_TICKS * _usual_change(going, way))

    last, following = going[:-1], going[1:]
    gap = following - last - 1
    ends_s = np.cumsum(motion.dt_s)
    gap_s = ends_s[following - 1] - ends_s[last]
    alone = (gap == 1) | ((gap > 1) & (gap <= _MOST_IN_A_ROW) & (gap_s < _LONGEST_S))
    zero = alone & plain[:-1] & plain[1:]
    caught_up = zero & (way[:-1] + way[1:] > _CAUGHT_UP * 2.0 * _around(way))
    found = zero & ~caught_up
    if caught_up.sum() > found.sum():
        found[:] = False  # the counts of this odometry arrive late: the apparent losses did, too
    if np.sum(found & (gap == 1)) < _FREQUENT * np.sum(fast):
        found &= gap == 1  # if hardly any increment is lost, several zeros in a row are a stop
    for begin, count in zip(last[found], gap[found], strict=True):
        gone[begin + 1 : begin + 1 + count] = True
    gone &= motion.dt_s > 0.0  # a duplicated stamp is no loss

    arrived = int(np.sum(plain[:-1] & plain[1:] & ((gap == 0) | found)))
    hidden = 1.0 - float(plain.sum()) / max(int(fast.sum()), 1)
    return Losses(gone, int(gone.sum()), int(gone.sum()) + arrived, hidden)


def _usual_change(going: NDArray[np.int64], way: Array) -> float:
    """Return the usual non-zero change between consecutive moving increments, metres: about one tick."""
    change = np.abs(np.diff(way))[np.diff(going) == 1]
    change = change[change > _ROUNDING_M]
    return float(np.quantile(change, _USUAL_QUANTILE)) if len(change) else 0.0


def _around(way: Array) -> Array:
    """Return the mean (n - 1,) of the increments around each pair of neighbours, excluding the pair."""
    padded = np.concatenate((np.full(_NEIGHBOURS, way[0]), way, np.full(_NEIGHBOURS, way[-1])))
    total = np.convolve(padded, np.ones(2 * _NEIGHBOURS + 2), "valid")
    around: Array = (total[: len(way) - 1] - way[:-1] - way[1:]) / (2.0 * _NEIGHBOURS)
    return around

"""Some increments never arrive."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from odomcorrupt.effects.draws import again
from odomcorrupt.effects.effect import (
    About,
    Effect,
    Gain,
    Kind,
    Layer,
    Moments,
    Motion,
    Recorded,
    State,
    TwistError,
    parameter,
    stacked,
)

if TYPE_CHECKING:
    from numpy.random import Generator

    from odomcorrupt.pose import Array


@dataclass(frozen=True, slots=True)
class LostIncrements(Effect):
    """Each increment is lost with probability `fraction`: the reported pose stands still while the robot goes on.

    On average it looks like a scale error of the same size, but which increments are lost is chance: it counts as
    noise, and a correction that scaled the others up would miss what is seen plainly in the log.
    """

    name: ClassVar[str] = "lost_increments"
    kind: ClassVar[Kind] = "noise"
    layer: ClassVar[Layer] = "record"
    summary: ClassVar[str] = "some increments of the odometry are lost, with the way they stood for"
    about: ClassVar[About | None] = About(
        equation="reported increment = 0 with probability fraction",
        typical="0.1 to 5 % on a bad serial line (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("wheel_scale", "slip_burst"),
        drive="any: look for single increments of zero between neighbours that move, in the odometry alone",
    )

    fraction: float = parameter("", "part of the increments that is lost", low=0.0, high=0.9, typical=0.01)

    def start(self, rng: Generator) -> State:
        """Return what decides on losses."""
        return rng

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f = 0: what was reported is right, and nothing is known of the rest."""
        return TwistError(np.zeros((len(motion), 3)), state)

    def recorded(self, steps: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - no wheels here
        """Return the increments with the lost ones zero."""
        rng = again(state)
        lost = rng.uniform(size=len(steps)) < self.fraction
        return Recorded(np.where(lost[:, None], 0.0, steps), rng)

    def moments(self, motion: Motion) -> Moments:
        """Return the mean loss and its variance."""
        twist = stacked(motion.v, motion.vy, motion.omega, motion.v)
        return Moments(self.fraction * twist, self.fraction * (1.0 - self.fraction) * twist**2)

    def gains(self, motion: Motion) -> tuple[Gain, ...]:
        """Return one chance per increment, which remembers nothing; the mean loss is no part of it."""
        twist = stacked(motion.v, motion.vy, motion.omega, motion.v)
        variance = self.fraction * (1.0 - self.fraction)
        return (Gain(twist, np.zeros_like(motion.v), np.full_like(motion.v, variance), 0.0),)

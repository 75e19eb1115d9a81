"""Castors that turn the robot as they swing round after each reversal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from odomcorrupt.drive_types import PIVOTING
from odomcorrupt.effects.backlash import AT_REST, crossed
from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.random import Generator

_SWING_TRAVELS_M = (0.05, 0.1, 0.2)
"""Trial travels of the swing, metres: castors trail by 10 to 50 mm and swing round within two to four times that."""


@dataclass(frozen=True, slots=True)
class CastorKick(Effect):
    """f = (0, 0, angle v / way) while the castors swing round, 0 once they trail.

    The castors' state is the play operator on the robot's travel: after a reversal they swing round within `way`.
    The next reversal undoes the turn, so driving forth and back leaves none.
    """

    name = "castor_kick"
    odd = True
    summary = "castors swing round after each reversal and turn the robot"
    drives = PIVOTING
    about = About(
        equation="f_yaw = angle v / way within `way` after each reversal of the travel, 0 elsewhere",
        typical="0.5 to 3 degrees within 5 to 20 cm (an estimate: off-centre castors, a load on one side)",
        source="engineering judgement; the play operator, as in Visintin 1994, Differential Models of Hysteresis",
        confused_with=("backlash", "unequal_wheels"),
        drive="drive a metre forth and back, many times, with long straights between",
    )

    angle: float = parameter("rad", "turn left after a reversal to forwards", low=-0.3, high=0.3, typical=0.02)
    way: float = parameter(
        "m", "travel within which the castors swing round", low=0.01, high=0.5, typical=0.1, identity=0.1,
        amplitude=False,
    )  # fmt: skip

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:  # noqa: ARG003 - castor sizes do not depend on the drive
        """Return a candidate for each trial travel of the swing."""
        return tuple(replace(cls(), way=way) for way in _SWING_TRAVELS_M)

    def start(self, rng: Generator) -> State:  # noqa: ARG002 - nothing is drawn
        """Return the state of trailing castors."""
        return AT_REST

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: a turn in proportion to the travel during which the castors swing."""
        swing, after = crossed(motion.v * motion.dt_s, state, self.way)
        rate = np.divide(self.angle / self.way, motion.dt_s, out=np.zeros_like(swing), where=motion.dt_s > 0.0)
        return TwistError(stacked(0.0, 0.0, rate * swing, motion.v), after)

"""Downhill creep of a robot that drives on a slope."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked

if TYPE_CHECKING:
    from collections.abc import Sequence

_DIRECTIONS = 12


@dataclass(frozen=True, slots=True)
class Slope(Effect):
    """f = creep abs(v) in a fixed direction of the truth frame, rotated into the body frame.

    Two of them at right angles span all directions linearly; a negative creep is the opposite direction.
    """

    name = "slope"
    odd = True
    summary = "the robot creeps in one direction of the world as it drives"
    reads_truth = True
    reads_places = True
    about = About(
        equation="f = creep abs(v) (cos(direction - theta), sin(direction - theta), 0)",
        typical="0.3 to 3 % of the way on ramps of 2 to 5 degrees (an estimate)",
        source="slip under a constant force, with a linear tyre (Rajamani, Vehicle Dynamics and Control)",
        confused_with=("mount_yaw", "wheel_scale", "region_slip"),
        drive="drive the same place in all four headings",
    )

    creep: float = parameter("", "creep per metre driven", low=-0.2, high=0.2, typical=0.01)
    direction: float = parameter(
        "rad", "heading it creeps towards, in the truth frame", low=-6.29, high=6.29, typical=1.0, amplitude=False
    )

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:  # noqa: ARG003 - directions do not depend on the drive
        """Return directions over half a turn, 15 degrees apart; the sign of the creep covers the other half."""
        return tuple(cls(direction=math.pi * i / _DIRECTIONS) for i in range(_DIRECTIONS))

    def plain(self) -> Self:
        """Return the equivalent effect with positive creep."""
        turned = self.direction + (math.pi if self.creep < 0.0 else 0.0)
        return replace(self, creep=abs(self.creep), direction=math.remainder(turned, 2.0 * math.pi))

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the downhill creep in the body frame."""
        speed = self.creep * np.abs(motion.v)
        away = self.direction - motion.theta
        return TwistError(stacked(speed * np.cos(away), speed * np.sin(away), 0.0, motion.v), state)

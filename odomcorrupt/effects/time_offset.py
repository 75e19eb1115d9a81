"""Constant offset of the odometry's stamps."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array


@dataclass(frozen=True, slots=True)
class TimeOffset(Effect):
    """f = offset (a, ay, alpha); in a bag, every odometry stamp moves by the offset.

    f is a first-order equivalent for the regression only; the stamp shift is exact.
    """

    name = "time_offset"
    odd = True
    kind = "setup"
    summary = "the odometry's clock is ahead of the truth's by a constant"
    clock = True
    about = About(
        equation="f = offset (a, ay, alpha)",
        typical="5 to 150 ms by USB, WiFi or motion capture",
        source="engineering judgement; no published figures known to us",
        confused_with=("accel_slip", "clock_skew", "backlash"),
        drive="start, stop and turn briskly",
    )

    offset: float = parameter("s", "odometry stamp minus true time", low=-5.0, high=5.0, typical=0.03)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f to first order: the twist a little later minus the present twist."""
        return TwistError(self.offset * motion.acceleration, state)

    def stamp_shift_s(self, t_s: Array) -> Array:
        """Return the stamp shift (n,), seconds: the constant offset."""
        return np.full_like(t_s, self.offset)

"""Wheels slip in proportion to the force they have to bring to the ground."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Kind, Motion, State, TwistError, choice, parameter, stacked
from odomcorrupt.effects.wheels import Rims, body_of, heading_choice, needed_track_m, wheel_motions

if TYPE_CHECKING:
    from odomcorrupt.pose import Array


@dataclass(frozen=True, slots=True)
class AccelSlip(Effect):
    """f = (-k abs(v) a, 0, 0): a slip ratio in proportion to the acceleration of the body; or of each rim, of its own.

    It is a total derivative, -k/2 d(v abs(v)), and cancels from stop to stop; that is why v is the speed that a is the
    rate of, the body's own. Whatever its strength, it can be put in and taken out.
    """

    name: ClassVar[str] = "accel_slip"
    kind: ClassVar[Kind] = "effect"
    summary: ClassVar[str] = "wheels slip when the robot speeds up, and skid when it brakes"
    reads_truth: ClassVar[bool] = True
    about: ClassVar[About | None] = About(
        equation="f_along = -k abs(v) a; contact = wheels: f_wheel = -k abs(u) du/dt of each rim u",
        typical="a slip of 0.5 to 6 % at 1 m/s^2 (an estimate)",
        source="Rajamani, Vehicle Dynamics and Control (slip ratio and longitudinal tyre force)",
        confused_with=("time_offset", "backlash", "speed_scale"),
        drive="speed up and brake hard, at two speeds, with turns on the spot between: a late clock delays these too",
    )

    k: float = parameter("s^2/m", "slip ratio per acceleration", low=0.0, high=0.2, typical=0.02)
    heading: str = heading_choice()
    contact: str = choice("what has to speed up to slip: the robot as a whole, or each wheel", "body", "wheels")

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: behind while speeding up, ahead while braking."""
        if self.contact == "wheels":
            track_m = needed_track_m(self.name, motion.track_m)
            rims = Rims(*(self._gained(wheel) for wheel in wheel_motions(motion, track_m)))
            return TwistError(body_of(rims, track_m, self.heading), state)
        return TwistError(stacked(self._gained(motion), 0.0, 0.0, motion.v), state)

    def _gained(self, motion: Motion) -> Array:
        """Return the speed (n,) that is gained, below zero while speeding up."""
        return -self.k * np.abs(motion.steady_v) * motion.a

"""Wheel slip in proportion to the traction force."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, choice, parameter, stacked
from odomcorrupt.effects.wheels import (
    Rims,
    body_of,
    heading_choice,
    needed_track_m,
    on_every_track,
    track_parameter,
    wheel_motions,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array


@dataclass(frozen=True, slots=True)
class AccelSlip(Effect):
    """f = (-k abs(v) a, 0, 0): slip ratio proportional to acceleration, of the body or of each wheel.

    With contact = axle both wheels slip by the same ratio: the faster one loses more, and the robot turns less than
    it reports. The acceleration that each wheel feels in a turn depends on the robot's inertia (contact = wheels).

    f is a total derivative, -k/2 d(v abs(v)), and cancels from stop to stop. Therefore v is the speed whose rate is a,
    that of the body. The effect can be applied and inverted at any strength.
    """

    name = "accel_slip"
    odd = True
    summary = "wheels slip when the robot speeds up, and skid when it brakes"
    reads_truth = True
    about = About(
        equation="f_along = -k abs(v) a; of each rim u, contact = axle: f_wheel = -k abs(u) a, wheels: -k abs(u) du/dt",
        typical="a slip of 0.5 to 6 % at 1 m/s^2 (an estimate)",
        source="Rajamani, Vehicle Dynamics and Control (slip ratio and longitudinal tyre force)",
        confused_with=("time_offset", "backlash", "speed_scale"),
        drive="speed up and brake hard, at two speeds, with turns on the spot between: a late clock delays these too",
    )

    k: float = parameter("s^2/m", "slip ratio per acceleration", low=0.0, high=0.2, typical=0.02)
    heading: str = heading_choice()
    contact: str = choice(
        "what slips, and at whose acceleration: the robot as a whole, each wheel at the robot's, or each at its own",
        "body", "axle", "wheels",
    )  # fmt: skip
    track: float = track_parameter()

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:
        """Return candidates for the body and for single wheels, the latter on each trial track if it is unknown."""
        wheels = on_every_track((cls(contact="axle"), cls(contact="wheels")), motions)
        return (cls(), *(effect for effect in wheels if effect.track))

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the robot lags its odometry while speeding up and leads it while braking."""
        if self.contact == "body":
            return TwistError(stacked(self._gained(motion, motion.a), 0.0, 0.0, motion.v), state)
        track_m = needed_track_m(self.name, self.track or motion.track_m)
        wheels = wheel_motions(motion, track_m)
        rims = Rims(*(self._gained(wheel, motion.a if self.contact == "axle" else wheel.a) for wheel in wheels))
        return TwistError(body_of(rims, track_m, self.heading), state)

    def _gained(self, motion: Motion, faster: Array) -> Array:
        """Return the true minus reported speed (n,) of the body or a wheel, negative while speeding up."""
        return -self.k * np.abs(motion.steady_v) * faster

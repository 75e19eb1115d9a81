"""Wheels slip in proportion to the force they have to bring to the ground."""

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
    """f = (-k abs(v) a, 0, 0): a slip ratio in proportion to the acceleration of the body; or of each rim, of its own.

    Where both wheels slip by the same ratio, the faster one loses more, and the robot turns less than it reports: that
    is the axle's contact. How much of a turn's acceleration a wheel feels besides is a matter of the robot's inertia.

    It is a total derivative, -k/2 d(v abs(v)), and cancels from stop to stop; that is why v is the speed that a is the
    rate of, the body's own. Whatever its strength, it can be put in and taken out.
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
        """Return the slip of the body; and of single wheels, on every track that is tried, where none is known."""
        wheels = on_every_track((cls(contact="axle"), cls(contact="wheels")), motions)
        return (cls(), *(effect for effect in wheels if effect.track))

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: behind while speeding up, ahead while braking."""
        if self.contact == "body":
            return TwistError(stacked(self._gained(motion, motion.a), 0.0, 0.0, motion.v), state)
        track_m = needed_track_m(self.name, self.track or motion.track_m)
        wheels = wheel_motions(motion, track_m)
        rims = Rims(*(self._gained(wheel, motion.a if self.contact == "axle" else wheel.a) for wheel in wheels))
        return TwistError(body_of(rims, track_m, self.heading), state)

    def _gained(self, motion: Motion, faster: Array) -> Array:
        """Return the speed (n,) that something moving so gains, below zero while speeding up."""
        return -self.k * np.abs(motion.steady_v) * faster

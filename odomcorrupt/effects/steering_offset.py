"""Steering that is not straight at a sensor reading of zero."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

from odomcorrupt.drive_types import STEERED
from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked
from odomcorrupt.effects.steering import axles_parameter, driven_choice, on_every_axle_distance, steepness, turned_front

if TYPE_CHECKING:
    from collections.abc import Sequence


@dataclass(frozen=True, slots=True)
class SteeringOffset(Effect):
    """f = (0, 0, curvature v (1 + tan^2 delta)): the bicycle's yaw rate with an angle delta + d, curvature = d / L.

    With L the distance between the axles, tan delta = L omega / v; without it delta is assumed small. With driven =
    front the velocity (v, L omega) of the steered wheel, whose travel is measured, is turned by d.
    Rajamani, Vehicle Dynamics and Control, ch. 2 (kinematic bicycle): omega = v tan(delta) / L.
    """

    name = "steering_offset"
    summary = "the steering of a car or tricycle is not straight at zero, so that straight lines bend"
    drives = STEERED
    unsteered = "unequal_wheels"
    about = About(
        equation="f_yaw = curvature v; times 1 + (axles omega / v)^2 where the steering angles are large; "
        "f_along = -curvature axles^2 omega if the steered wheel is driven",
        typical="0.2 to 2 degrees: 0.01 to 0.1 rad/m on 0.3 m between the axles, 0.001 to 0.01 rad/m on 2.7 m",
        source="Rajamani, Vehicle Dynamics and Control, chapter 2 (kinematic bicycle model)",
        confused_with=("gyro_bias", "turn_asymmetry", "mount_yaw"),
        drive="long straights forwards and in reverse, at two speeds, with a stop of a minute",
    )

    curvature: float = parameter(
        "rad/m", "true curvature of a path that odometry reports as straight", low=-1.0, high=1.0, typical=0.01
    )
    axles: float = axles_parameter()
    driven: str = driven_choice()

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:
        """Return the effect for small steering angles, and for large ones."""
        return on_every_axle_distance(cls(), motions)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the yaw error is proportional to the distance, and changes sign in reverse."""
        if self.driven == "front":
            return TwistError(turned_front(motion.v, motion.omega, self.curvature, self.axles), state)
        steep = 1.0 + steepness(motion.v, motion.omega, self.axles) ** 2 if self.axles else 1.0
        return TwistError(stacked(0.0, 0.0, self.curvature * steep * motion.v, motion.v), state)

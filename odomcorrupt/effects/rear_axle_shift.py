"""Odometry reference point that is not on the rear axle."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.drive_types import STEERED
from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class RearAxleShift(Effect):
    """f = (0, x omega, 0): a car has no sideways motion at its rear axle, but x omega at a distance x ahead of it.

    Rajamani, Vehicle Dynamics and Control, ch. 2 (kinematic bicycle, rear axle as reference).
    """

    name = "rear_axle_shift"
    summary = "a car's or tricycle's odometry is not that of a point on its rear axle"
    drives = STEERED
    aliased_with = "lever_arm"
    about = About(
        equation="f_across = x omega",
        typical="a part of the distance between the axles: a base frame at the centre of mass or at the front axle",
        source="Rajamani, Vehicle Dynamics and Control, chapter 2 (kinematic bicycle model)",
        confused_with=("lever_arm", "side_slip", "mount_yaw"),
        drive="curves to both sides at two speeds; to separate it from a lever arm, move the marker and drive again",
    )

    x: float = parameter("m", "of the odometry's point ahead of the rear axle", low=-5.0, high=5.0, typical=0.2)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the reference point moves sideways in turns."""
        return TwistError(stacked(0.0, self.x * motion.omega, 0.0, motion.v), state)

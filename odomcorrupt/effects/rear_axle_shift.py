"""The odometry's reference point is not on the rear axle."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from odomcorrupt.drive_types import STEERED
from odomcorrupt.effects.effect import About, Effect, Kind, Motion, State, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class RearAxleShift(Effect):
    """f = (0, x omega, 0): a car's wheels do not move sideways on its rear axle, and do x ahead of it.

    Rajamani, Vehicle Dynamics and Control, ch. 2 (kinematic bicycle, rear axle as reference).
    """

    name: ClassVar[str] = "rear_axle_shift"
    kind: ClassVar[Kind] = "effect"
    summary: ClassVar[str] = "a car's or tricycle's odometry is not that of a point on its rear axle"
    drives: ClassVar[frozenset[str] | None] = STEERED
    twin_of: ClassVar[str | None] = "lever_arm"
    about: ClassVar[About | None] = About(
        equation="f_across = x omega",
        typical="a part of the distance between the axles: a base frame at the centre of mass or at the front axle",
        source="Rajamani, Vehicle Dynamics and Control, chapter 2 (kinematic bicycle model)",
        confused_with=("lever_arm", "side_slip", "mount_yaw"),
        drive="curves to both sides at two speeds; to tell it from a lever arm, move the marker and drive again",
    )

    x: float = parameter("m", "of the odometry's point ahead of the rear axle", low=-5.0, high=5.0, typical=0.2)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the reference point swings sideways in turns."""
        return TwistError(stacked(0.0, self.x * motion.omega, 0.0, motion.v), state)

"""Truth that tracks another point of the robot than the odometry."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class LeverArm(Effect):
    """f = (-y omega, x omega, 0), with the tracked point at (x, y) in the base frame.

    Censi, Marchionni, Oriolo & Franchi 2013, IEEE T-RO 29(2) (a sensor's extrinsics).
    """

    name = "lever_arm"
    odd = True
    kind = "setup"
    summary = "the point that the truth follows is not the origin of the base frame"
    about = About(
        equation="f = (-y omega, x omega, 0)",
        typical="1 to 20 cm where nobody has measured it",
        source="Censi, Marchionni, Oriolo & Franchi 2013, IEEE T-RO 29(2)",
        confused_with=("icr_shift", "mount_yaw", "side_slip", "unequal_wheels"),
        drive="turn on the spot both ways, and straights; a second position of the marker separates it from icr_shift",
    )

    x: float = parameter("m", "tracked point ahead of the base frame", low=-5.0, high=5.0, typical=0.03)
    y: float = parameter("m", "tracked point to the left of the base frame", low=-5.0, high=5.0, typical=0.03)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the motion in turns of a point off the axis."""
        return TwistError(stacked(-self.y * motion.omega, self.x * motion.omega, 0.0, motion.v), state)

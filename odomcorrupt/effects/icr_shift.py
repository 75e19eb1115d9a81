"""Centre of rotation that is not the origin of the base frame."""

from __future__ import annotations

from dataclasses import dataclass

from odomcorrupt.drive_types import PIVOTING
from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class IcrShift(Effect):
    """f = (0, x omega, 0): the robot turns about a point at -x, as skid-steered robots with an off-centre load do."""

    name = "icr_shift"
    summary = "the robot turns about a point ahead of or behind its base frame"
    drives = PIVOTING
    aliased_with = "lever_arm"
    about = About(
        equation="f_across = x omega",
        typical="a few centimetres on skid-steered and tracked robots",
        source="Martinez, Mandow, Morales, Pedraza & Garcia-Cerezo 2005, IJRR 24(10)",
        confused_with=("lever_arm", "side_slip", "mount_yaw"),
        drive="turn on the spot; to separate it from a lever arm, move the marker and drive again",
    )

    x: float = parameter("m", "minus the x of the rotation centre", low=-0.5, high=0.5, typical=0.03)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the origin of the base frame moves sideways in turns."""
        return TwistError(stacked(0.0, self.x * motion.omega, 0.0, motion.v), state)

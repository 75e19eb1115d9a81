"""Forward axis of the truth that is not the robot's."""

from __future__ import annotations

import math
from dataclasses import dataclass

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class MountYaw(Effect):
    """f = (cos(yaw) - 1, -sin(yaw)) v, and likewise for vy: the same motion in axes rotated by yaw.

    Censi, Marchionni, Oriolo & Franchi 2013, IEEE T-RO 29(2) (a sensor's extrinsics).
    """

    name = "mount_yaw"
    kind = "setup"
    summary = "the truth's forward axis is turned against the robot's"
    about = About(
        equation="f = (cos(yaw) - 1, -sin(yaw)) v, and the like for vy",
        typical="0.1 to 3 degrees",
        source="Censi, Marchionni, Oriolo & Franchi 2013, IEEE T-RO 29(2)",
        confused_with=("lever_arm", "icr_shift", "slope"),
        drive="long straights in several headings",
    )

    yaw: float = parameter("rad", "heading of the truth frame on the robot", low=-3.2, high=3.2, typical=0.02)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: straight travel appears to slide sideways."""
        c, s = math.cos(self.yaw), math.sin(self.yaw)
        along = (c - 1.0) * motion.v + s * motion.vy
        across = -s * motion.v + (c - 1.0) * motion.vy
        return TwistError(stacked(along, across, 0.0, motion.v), state)

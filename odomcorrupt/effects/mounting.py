"""Poses of points and axes on the robot: the truth's tracked point and axis, and the centre of rotation."""

from __future__ import annotations

import math
from dataclasses import dataclass

from odomcorrupt.drive_types import PIVOTING, STEERED
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

"""Poses of points and axes on the robot: the truth's tracked point and axis, and the centre of rotation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from odomcorrupt.drive_types import PIVOTING, STEERED
from odomcorrupt.effects.effect import About, Motion, gain, parameter

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array


LeverArm = gain(
    "lever_arm",
    "the point that the truth follows is not the origin of the base frame",
    lambda it, m: (-it.y * m.omega, it.x * m.omega, 0.0),
    About(
        equation="f = (-y omega, x omega, 0)",
        typical="1 to 20 cm where nobody has measured it",
        source="Censi, Marchionni, Oriolo & Franchi 2013, IEEE T-RO 29(2)",
        confused_with=("icr_shift", "mount_yaw", "side_slip", "unequal_wheels"),
        drive="turn on the spot both ways, and straights; a second position of the marker separates it from icr_shift",
    ),
    kind="setup",
    odd=True,
    x=parameter("m", "tracked point ahead of the base frame", low=-5.0, high=5.0, typical=0.03),
    y=parameter("m", "tracked point to the left of the base frame", low=-5.0, high=5.0, typical=0.03),
)


def _in_turned_axes(it: Any, m: Motion) -> tuple[Array, Array, float]:
    """Return f of the same motion in axes rotated by the yaw."""
    c, s = math.cos(it.yaw), math.sin(it.yaw)
    return (c - 1.0) * m.v + s * m.vy, -s * m.v + (c - 1.0) * m.vy, 0.0


MountYaw = gain(
    "mount_yaw",
    "the truth's forward axis is turned against the robot's",
    _in_turned_axes,
    About(
        equation="f = (cos(yaw) - 1, -sin(yaw)) v, and the like for vy",
        typical="0.1 to 3 degrees",
        source="Censi, Marchionni, Oriolo & Franchi 2013, IEEE T-RO 29(2)",
        confused_with=("lever_arm", "icr_shift", "slope"),
        drive="long straights in several headings",
    ),
    kind="setup",
    yaw=parameter("rad", "heading of the truth frame on the robot", low=-3.2, high=3.2, typical=0.02),
)

# the rotation centre is at -x, as of skid-steered robots with an off-centre load
IcrShift = gain(
    "icr_shift",
    "the robot turns about a point ahead of or behind its base frame",
    lambda it, m: (0.0, it.x * m.omega, 0.0),
    About(
        equation="f_across = x omega",
        typical="a few centimetres on skid-steered and tracked robots",
        source="Martinez, Mandow, Morales, Pedraza & Garcia-Cerezo 2005, IJRR 24(10)",
        confused_with=("lever_arm", "side_slip", "mount_yaw"),
        drive="turn on the spot; to separate it from a lever arm, move the marker and drive again",
    ),
    drives=PIVOTING,
    aliased_with="lever_arm",
    x=parameter("m", "minus the x of the rotation centre", low=-0.5, high=0.5, typical=0.03),
)

# a car has no sideways motion at its rear axle, but x omega at a distance x ahead of it
RearAxleShift = gain(
    "rear_axle_shift",
    "a car's or tricycle's odometry is not that of a point on its rear axle",
    lambda it, m: (0.0, it.x * m.omega, 0.0),
    About(
        equation="f_across = x omega",
        typical="a part of the distance between the axles: a base frame at the centre of mass or at the front axle",
        source="Rajamani, Vehicle Dynamics and Control, chapter 2 (kinematic bicycle model)",
        confused_with=("lever_arm", "side_slip", "mount_yaw"),
        drive="curves to both sides at two speeds; to separate it from a lever arm, move the marker and drive again",
    ),
    drives=STEERED,
    aliased_with="lever_arm",
    x=parameter("m", "of the odometry's point ahead of the rear axle", low=-5.0, high=5.0, typical=0.2),
)

"""Wrong gains of the motion: sizes of wheels and track, constant or not, and poses of points on the robot."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from odomcorrupt.drive_types import PIVOTING, STEERED
from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, choice, gain, parameter, stacked
from odomcorrupt.effects.wheels import (
    Rims,
    body_of,
    heading_choice,
    needed_track_m,
    on_every_track,
    rims_of,
    scaled,
    track_parameter,
    turning,
    wheel_motions,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array


WheelScale = gain(
    "wheel_scale",
    "the wheels' true radius differs from the nominal one",
    lambda it, m: scaled(m, it.e, it.heading),
    About(
        equation="f = e (v, vy, omega); e (v, vy, 0) with a gyro",
        typical="0.2 to 2 %; inflatable tyres up to 3 %",
        source="Borenstein & Feng 1996, IEEE T-RA 12(6), E_s",
        confused_with=("speed_scale", "scale_drift", "lost_increments", "lever_arm"),
        drive="straights and turns, at two speeds",
    ),
    odd=True,
    e=parameter("", "true over nominal wheel radius, minus one", low=-0.9995, high=1999.0, typical=0.01),
    heading=heading_choice(),
)

Wheelbase = gain(
    "wheelbase",
    "the true distance between the wheels differs from the nominal track",
    lambda it, m: (0.0, 0.0, -it.e / (1.0 + it.e) * m.omega),
    About(
        equation="f_yaw = -e / (1 + e) omega",
        typical="0.5 to 5 % with wide tyres; factors of 1.3 to 2 when skid-steering",
        source="Borenstein & Feng 1996, IEEE T-RA 12(6), E_b",
        confused_with=("gyro_scale", "turn_asymmetry", "speed_scale"),
        drive="turn on the spot both ways; only the source of the heading separates the two",
    ),
    drives=PIVOTING,
    e=parameter("", "true over nominal track, minus one", low=-0.9995, high=1999.0, typical=0.015),
)

# with radii r_right / r_left = 1 + e, curvature = e / b; the first term only if the track b is known
UnequalWheels = gain(
    "unequal_wheels",
    "one wheel is larger than the other, so that straight lines bend",
    lambda it, m: (it.curvature * (m.track_m or 0.0) ** 2 / 4.0 * m.omega, 0.0, it.curvature * m.v),
    About(
        equation="f_yaw = curvature v; with the track b also f_along = curvature b^2 omega / 4",
        typical="wheels that differ by 0.05 to 1 %: 0.001 to 0.03 rad/m on a track of 0.4 m",
        source="Borenstein & Feng 1996, IEEE T-RA 12(6), E_d",
        confused_with=("gyro_bias", "turn_asymmetry"),
        drive="long straights, forwards and in reverse, at two speeds, with a stop of a minute",
    ),
    drives=PIVOTING,
    curvature=parameter(
        "rad/m", "true curvature of a path that odometry reports as straight", low=-1.0, high=1.0, typical=0.005
    ),
)

TurnAsymmetry = gain(
    "turn_asymmetry",
    "left turns come out larger than right turns, or the other way round",
    lambda it, m: (0.0, 0.0, it.k * np.abs(m.omega)),
    About(
        equation="f_yaw = k abs(omega)",
        typical="0.3 to 3 % (an estimate: an off-centre load, a tyre that scrubs on one side)",
        source="engineering judgement; no published figures known to us",
        confused_with=("unequal_wheels", "gyro_bias", "wheelbase"),
        drive="turn on the spot, as often to the left as to the right, with straights between",
    ),
    odd=True,
    k=parameter("", "half the difference of the gains, left minus right", low=-0.2, high=0.2, typical=0.01),
)

ScaleDrift = gain(
    "scale_drift",
    "the scale of distance and turn changes with time",
    lambda it, m: scaled(m, it.rate * (it.settle * -np.expm1(-m.t_s / it.settle) if it.settle else m.t_s), it.heading),
    About(
        equation="f = rate t (v, vy, omega); rate t (v, vy, 0) with a gyro; t may settle, as 1 - exp(-t / settle)",
        typical="1 to 2 % over a long drive with a leaking tyre; 0.3 % per 10 K of tyre temperature (an estimate)",
        source="the idea: time-varying radii in Kuemmerle, Grisetti & Burgard 2011; sizes are engineering judgement",
        confused_with=("wheel_scale", "region_slip", "clock_skew"),
        drive="repeat one loop for half an hour and more",
    ),
    odd=True,
    rate=parameter("1/s", "growth of the true radius per second, at first", low=-1e-3, high=1e-3, typical=1e-5),
    settle=parameter("s", "time in which it settles, as tyres warm up; 0: never", low=0.0, high=3600.0, typical=200.0,
                     amplitude=False, optional=True, trials=(0.0, 60.0, 150.0, 400.0)),
    heading=heading_choice(),
)  # fmt: skip

# a motor's speed is proportional to the voltage
BatterySag = gain(
    "battery_sag",
    "commanded speeds are reached less and less, as the battery's voltage falls",
    lambda it, m: scaled(m, it.rate * m.t_s, it.heading),
    About(
        equation="f = rate t (v, vy, omega), rate < 0, of the velocities that were commanded",
        typical="10 to 25 % from a full battery to an empty one: 5e-5 to 4e-4 per second (an estimate)",
        source="Hughes & Drury 2019, Electric Motors and Drives (a DC motor's speed is in proportion to its voltage)",
        confused_with=("scale_drift", "wheel_scale", "dead_band"),
        drive="repeat one loop for ten minutes and more; a full battery put in at half time separates it from a tyre",
    ),
    aliased_with="scale_drift",
    rate=parameter("1/s", "change of the reached fraction of the commanded speed, per second", low=-1e-3, high=0.0,
                   typical=-1e-4, step=1e-7),
    heading=heading_choice(),
)  # fmt: skip

SideSlip = gain(
    "side_slip",
    "the robot slips outwards in turns, in proportion to speed times yaw rate",
    lambda it, m: (0.0, -it.k * m.v * m.omega, 0.0),
    About(
        equation="f_across = -k v omega",
        typical="0.01 to 0.1 s (an estimate)",
        source="Rajamani, Vehicle Dynamics and Control (linear tyre)",
        confused_with=("icr_shift", "lever_arm", "mount_yaw"),
        drive="the same turn slowly and fast",
    ),
    odd=True,
    k=parameter("s", "sideways speed per speed and yaw rate", low=0.0, high=0.5, typical=0.03),
)

SidewaysScale = gain(
    "sideways_scale",
    "sideways the robot goes farther or less far than its wheels show",
    lambda it, m: (0.0, it.e * m.vy, 0.0),
    About(
        equation="f = (0, e vy, 0)",
        typical="-1 to -10 %: rollers of mecanum wheels slip and have play when the robot goes sideways (an estimate)",
        source="Tlale & de Villiers 2008, Kinematics and dynamics modelling of a mecanum wheeled mobile platform",
        confused_with=("wheel_scale", "mount_yaw", "side_slip"),
        drive="sideways to and fro, at two headings, and straights as long",
    ),
    needs_sideways=True,
    e=parameter("", "true over nominal sideways travel, minus one", low=-0.9995, high=1999.0, typical=0.03),
)

# A contact that spins about its normal has less grip for travel, and rollers of omnidirectional wheels scrub across
# their path. The moment of dry friction against a turn hardly depends on its rate, so that slow turns lose the larger
# share.
TurnScrub = gain(
    "turn_scrub",
    "wheels or rollers scrub in turns: travel and turn are wrong by a share that changes with the turn rate",
    lambda it, m: (
        it.travel * np.abs(m.omega) * m.v,
        it.travel * np.abs(m.omega) * m.vy,
        it.turn * np.abs(m.omega) * m.omega,
    ),
    About(
        equation="f = abs(omega) (travel v, travel vy, turn omega)",
        typical="mecanum wheels -0.32 s of travel, along and sideways alike, 0.09 s of turn (6 and 2 % at 0.2 rad/s); "
        "two wheels 0.004 s of turn (measured, docs/optiodom.md)",
        source="Pacejka, Tire and Vehicle Dynamics, on turn slip; sizes from runs of Sousa et al. 2022 (OptiOdom)",
        confused_with=("wheel_scale", "wheelbase", "speed_scale"),
        drive="the same way straight ahead and while turning, and turns at two rates",
    ),
    odd=True,
    travel=parameter("s", "change of the scale of travel per turn rate", low=-2.0, high=2.0, typical=0.05),
    turn=parameter("s", "change of the scale of turns per turn rate", low=-2.0, high=2.0, typical=0.02),
)

# The force m (-omega vy, omega v) on a centre of mass ahead of that of the wheels, or to its left, is a moment: wheels
# yield to it in proportion, as they do to a force across (`side_slip`).
OffCentreLoad = gain(
    "off_centre_load",
    "a load ahead or beside the centre of the wheels turns the robot in bends",
    lambda it, m: (0.0, 0.0, m.omega * (it.x * m.v + it.y * m.vy)),
    About(
        equation="f_yaw = omega (x v + y vy)",
        typical="0.05 to 0.3 s/m: y -0.2 to -0.3 with mecanum wheels, -0.04 with three omnidirectional ones, "
        "measured, docs/optiodom.md",
        source="Newton's law, with creep of wheels in proportion to force (Pacejka, Tire and Vehicle Dynamics)",
        confused_with=("turn_scrub", "sideways_turn", "unequal_wheels"),
        drive="circles both ways, ahead, in reverse and sideways",
    ),
    odd=True,
    needs_sideways=True,
    x=parameter("s/m", "share of the turn per speed ahead, of a load ahead", low=-1.0, high=1.0, typical=0.05),
    y=parameter("s/m", "share of the turn per speed to the left", low=-1.0, high=1.0, typical=0.05),
)

# of wheels that differ; the part that turns it in proportion to its forward travel is `unequal_wheels`
SidewaysTurn = gain(
    "sideways_turn",
    "the robot turns as it drives sideways, because its wheels differ in radius or grip",
    lambda it, m: (0.0, 0.0, it.k * m.vy),
    About(
        equation="f_yaw = k vy",
        typical="0.01 to 0.1 rad/m: a wheel 1 % larger, 0.2 m from the centre (by the kinematics)",
        source="Siegwart, Nourbakhsh & Scaramuzza, Introduction to Autonomous Mobile Robots, section 3.2.5",
        confused_with=("unequal_wheels", "gyro_bias"),
        drive="sideways to and fro, and straights as long",
    ),
    needs_sideways=True,
    k=parameter("rad/m", "true minus nominal turn per metre to the left", low=-1.0, high=1.0, typical=0.03),
)


def _grown(it: Any, m: Motion) -> tuple[Array, Array | float, Array]:
    """Return f of a radius that grows with the speed u of its rim; without a track, its limit for the body.

    With a track, both radii change alike in a turn on the spot, and the turn changes with them.
    """
    n = 1 if it.power == "linear" else 2
    if m.track_m is None:
        grown = it.k * np.abs(m.v) ** n
        return grown * m.v, 0.0, turning(it.heading, (n + 1.0) * grown * m.omega)
    rims = Rims(*(it.k * np.abs(u) ** n * u for u in rims_of(m.v, m.omega, m.track_m)))
    return tuple(body_of(rims, m.track_m, it.heading).T)


SpeedScale = gain(
    "speed_scale",
    "the wheels' radius changes with their speed",
    _grown,
    About(
        equation="f_wheel = k abs(u) u for each wheel's rim speed u (power = square: k u^3); no yaw with a gyro",
        typical="0.1 to 3 % per m/s; square: by centrifugal force or drag, -3 % at full speed (an estimate)",
        source="tyre growth and slip, as in any text on tyres; sizes are engineering judgement",
        confused_with=("wheel_scale", "accel_slip", "wheelbase"),
        drive="the same straight slowly and fast",
    ),
    odd=True,
    k=parameter("s/m", "growth of the radius per rim speed; square: at 1 m/s", low=-0.1, high=0.1, typical=0.01),
    heading=heading_choice(),
    power=choice("how the growth depends on the rim speed", "linear", "square"),
)


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
        track_m = needed_track_m(self, motion.track_m)
        wheels = wheel_motions(motion, track_m)
        rims = Rims(*(self._gained(wheel, motion.a if self.contact == "axle" else wheel.a) for wheel in wheels))
        return TwistError(body_of(rims, track_m, self.heading), state)

    def _gained(self, motion: Motion, faster: Array) -> Array:
        """Return the true minus reported speed (n,) of the body or a wheel, negative while speeding up."""
        return -self.k * np.abs(motion.steady_v) * faster


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

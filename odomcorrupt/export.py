"""Parameters of other programs: variances for robot_localization, alphas for nav2, wheels for ros2_control and Gazebo.

As numbers, and as YAML or SDF with comments on what they cannot represent; docs/export.md derives each formula.
**amcl scales the variance of one update by its squared motion** (Probabilistic Robotics ch. 5.4), with rot1 = 0 on the
spot and rot1 = rot2 = half the turn along an arc.
"""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from odomcorrupt.corruption.covariance import FLOOR
from odomcorrupt.drive_types import STEERED
from odomcorrupt.effects.gains import UnequalWheels, Wheelbase, WheelScale
from odomcorrupt.effects.steering import SteeringScale
from odomcorrupt.errors import ModelError
from odomcorrupt.geometry.se2 import Increments
from odomcorrupt.model.noise_laws import variances

if TYPE_CHECKING:
    from collections.abc import Mapping

    from odomcorrupt.model.motion_model import MotionModel, Noise


@dataclass(frozen=True, slots=True)
class Steady:
    """A steady drive: forward speed (m/s) and yaw rate (rad/s), both non-negative, and message rate (Hz)."""

    speed: float
    yaw_rate: float
    rate_hz: float

    def __post_init__(self) -> None:
        if not (min(self.speed, self.yaw_rate) >= 0.0 and self.rate_hz > 0.0):
            raise ModelError(
                f"drive: {self.speed:g} m/s, {self.yaw_rate:g} rad/s at {self.rate_hz:g} Hz; "
                "speeds must be zero or more and the rate more than zero"
            )


@dataclass(frozen=True, slots=True)
class MessageNoise:
    """Mean variances per message: heading, rad^2; along and across the heading, m^2.

    late : fraction of the heading variance that acts after the translation
    """

    heading: float
    late: float
    along: float
    across: float


def message_noise(noise: Noise, drive: Steady) -> MessageNoise:
    """Return the variances of one message; those of a law with a step are divided evenly over the step's messages."""
    k, share = noise.coefficients, 1.0
    dt_s = 1.0 / drive.rate_hz
    moved, turned = drive.speed * dt_s, drive.yaw_rate * dt_s
    if noise.step is not None:
        # a step ends at its distance or at its angle, whichever comes first
        share = max(moved / noise.step.distance_m, turned / noise.step.angle_rad) or 1.0
        half = np.array([turned / share / 2.0])
        v = noise.law.rule(k, half, np.array([moved / share]), half)
    else:
        v = variances(noise.law, k, Increments(np.array([moved]), np.zeros(1), np.array([turned])))
    white = (k.white_omega * dt_s) ** 2 + k.rot_time**2 * dt_s
    return MessageNoise(
        heading=share * float(v.rot1[0] + v.rot2[0]) + white,
        late=share * float(v.rot2[0]) + white / 2.0,
        along=share * float(v.trans[0]) + (k.white_v * dt_s) ** 2,
        across=share * float(v.across[0]),
    )


def twist_variances(noise: Noise, drive: Steady) -> tuple[float, float, float]:
    """Return the twist variances in a corrupted message's covariance on this steady drive.

    Those of forward and leftward speed, (m/s)^2, and of the yaw rate, (rad/s)^2.
    """
    message = message_noise(noise, drive)
    moved = drive.speed / drive.rate_hz
    # rot1 and rot2 noise displaces the translation laterally at mid heading; rot1 of an arc does not
    swing = message.late if noise.law.arc else message.heading
    sideways = message.across + 0.25 * swing * (moved**2 + message.along)
    forward, leftward, yaw = (v * drive.rate_hz**2 + FLOOR for v in (message.along, sideways, message.heading))
    return forward, leftward, yaw


Turn = Literal["rolling", "spot"]


def amcl_alphas(
    noise: Noise, update_min_d: float, update_min_a: float, *, turn: Turn = "rolling", drive: Steady, omni: bool = False
) -> dict[str, float]:
    """Return the amcl alphas with the model's variances after one update, for a straight drive and for a turn.

    alpha5 is noise across the travel, which the omnidirectional motion model alone reads.

    update_min_d, update_min_a : distance (m) and angle (rad) after which amcl updates its particles
    turn : whether the reference turn is along an arc (`rolling`) or on the spot
    drive : speeds of the straight drive and of the turn, and the odometry's rate, for noise that depends on these
    omni : whether they are of the omnidirectional motion model, which has one rotation per update
    """
    if not (update_min_d > 0.0 and update_min_a > 0.0):
        raise ModelError(
            f"update distances: {update_min_d:g} m, {update_min_a:g} rad; both must be more than zero, "
            "or amcl would update at every scan"
        )
    if not (drive.speed > 0.0 and drive.yaw_rate > 0.0):
        raise ModelError("speed and turn rate: the reference drives must move, so give both more than zero")
    straight = message_noise(noise, Steady(drive.speed, 0.0, drive.rate_hz))
    turning = message_noise(noise, Steady(0.0, drive.yaw_rate, drive.rate_hz))
    per_d2 = update_min_d * drive.rate_hz / drive.speed / update_min_d**2
    per_a2 = update_min_a * drive.rate_hz / drive.yaw_rate / update_min_a**2
    # differential: on a straight line, heading noise is drawn twice (rot1, rot2), and a rolling turn has two halves
    twice = 1.0 if omni else 2.0
    halves = twice if turn == "rolling" else 1.0
    alphas = (
        halves * turning.heading * per_a2, straight.heading * per_d2 / twice, straight.along * per_d2,
        halves * turning.along * per_a2, straight.across * per_d2,
    )  # fmt: skip
    return {f"alpha{i}": alpha for i, alpha in enumerate(alphas, start=1)}


WHEEL_EFFECTS = frozenset({WheelScale.name, UnequalWheels.name, Wheelbase.name})
"""Effects that are equivalent to a wrong radius or a wrong track."""
_TURNED = frozenset({WheelScale.name, Wheelbase.name, SteeringScale.name})
BASES = {
    "omni": ("mecanum_drive_controller", "mecanum-drive", "MecanumDrive", WHEEL_EFFECTS - {UnequalWheels.name}),
    "car": ("ackermann_steering_controller", "ackermann-steering", "AckermannSteering", _TURNED),
    "tricycle": ("tricycle_steering_controller", "", "", _TURNED),
    "": ("diff_drive_controller", "diff-drive", "DiffDrive", WHEEL_EFFECTS),
}
"""Controller of ros2_controllers, plugin of Gazebo, and the effects that constants of the wheels represent."""


def wheel_multipliers(model: MotionModel, track_m: float | None = None) -> dict[str, float]:
    """Return the ratios of true to nominal track and radii, by their names in a controller.

    With them a controller computes v = v' + f_along and omega = omega' + f_yaw. The separation of a steered base is
    that of its axles.

    track_m : nominal distance between the wheels, if the model does not contain it

    Raises
    ------
    ModelError
        If the track is needed and unknown, or a wheel's size would not be positive.
    """
    scale = 1.0 + sum(effect.e for effect in model.effects if isinstance(effect, WheelScale))
    turns = scale - sum(effect.e / (1.0 + effect.e) for effect in model.effects if isinstance(effect, Wheelbase))
    if wheel_layout(model) in STEERED:
        turns += sum(getattr(effect, "e", 0.0) for effect in model.effects if effect.name == SteeringScale.name)
    curvature = sum(effect.curvature for effect in model.effects if isinstance(effect, UnequalWheels))
    track = track_m if track_m is not None else model.track_m
    if curvature and track is None:
        raise ModelError(
            "unequal_wheels: its curvature determines the radii only with the distance between the wheels; "
            "give --track, or write [robot] track in the model file"
        )
    if not (scale > 0.0 and turns > 0.0):
        raise ModelError(f"wheel_scale and wheelbase: radius times {scale:g}, turns times {turns:g}: impossible")
    separation = scale / turns
    half = 0.5 * curvature * separation * (track or 0.0)
    if not abs(half) < scale:
        raise ModelError(f"unequal_wheels: curvature {curvature:g} rad/m leaves one wheel no radius on {track} m")
    return {
        "wheel_separation_multiplier": separation,
        "left_wheel_radius_multiplier": scale - half,
        "right_wheel_radius_multiplier": scale + half,
    }


_UNKNOWN = 1e6
"""Variance of quantities that a planar robot's odometry does not measure."""
_WIDTH = 80


@dataclass(frozen=True, slots=True)
class Snippet:
    """Parameters of another program as YAML, or as SDF, with comments.

    comments : assumptions, and why effects are left out
    lines : YAML or SDF without these
    values : parameters by name
    left_out : names of the effects that the program cannot represent
    """

    comments: tuple[str, ...]
    lines: tuple[str, ...]
    values: Mapping[str, float]
    left_out: tuple[str, ...]

    @property
    def text(self) -> str:
        """Comments and YAML or SDF."""
        sdf = self.lines[0].startswith("<")
        mark = "" if sdf else "# "
        wrapper = textwrap.TextWrapper(_WIDTH, initial_indent=mark, subsequent_indent=mark, break_on_hyphens=False)
        comments = [line for one in self.comments for line in wrapper.wrap(one)]
        return "\n".join([*(["<!--", *comments, "-->"] if sdf else comments), *self.lines])

    def condensed(self) -> str:
        """Return the SDF, or the YAML in flow style with one comment that names the effects it cannot express."""
        left = self.left_out
        said = f"not expressed: {', '.join(left)} (-v says why)" if left else "-v says what these numbers assume"
        said = said if len(said) <= _WIDTH - 9 else "some effects are not expressed: -v names them"
        if self.lines[0].startswith("<"):
            return "\n".join([f"<!-- {said} -->", *self.lines])
        lines = [f"# {said}"]
        bare = "\n".join(line for line in self.lines if not line.lstrip().startswith("#"))
        for node in re.split(r"\n(?=\S)", bare):
            head, *entries = re.split(r"\n {4}(?=\S)", node)
            name = head.split(":")[0]
            # a key and its number remain on one line
            flow = ", ".join(" ".join(entry.split()).replace(": ", ":\0") for entry in entries)
            lines += textwrap.wrap(f"{name}: {{ros__parameters: {{{flow}}}}}", _WIDTH, subsequent_indent="  ",
                                   break_long_words=False, break_on_hyphens=False)  # fmt: skip
        return "\n".join(lines).replace("\0", " ")


class Base(NamedTuple):
    """Nominal dimensions of a base, m: between left and right wheels, between the axles, radius; None if unknown."""

    track: float | None = None
    wheelbase: float | None = None
    radius: float | None = None


def wheel_layout(model: MotionModel) -> str:
    """Return "omni", "car", "tricycle", or "" for two wheels that are compared."""
    given = "omni" if model.noise.law.along_travel else model.setup.drive_type
    return given if given in BASES else ""


def gazebo_snippet(model: MotionModel, base: Base) -> Snippet:
    """Return the drive plugin of Gazebo whose odometry errs as the robot's does.

    base : dimensions of the simulated robot

    Raises
    ------
    ModelError
        If a dimension is unknown, a wheel's size would not be positive, or Gazebo has no such plugin.
    """
    layout = wheel_layout(model)
    _, plugin, name, represented = BASES[layout]
    if not plugin:
        raise ModelError(f"gazebo: no plugin is of a {layout}; let messages pass through oc.Drift (docs/api.md)")
    track, axles, radius, separation, *radii = _known(model, base, "gazebo: the plugin")
    mean = 0.5 * sum(radii)
    comments = ["The plugin computes odometry with these dimensions; the robot rolls on its links (docs/export.md)."]
    if "unequal_wheels" in represented and radii[0] != radii[1]:
        left, right = (number(radius * own / mean) for own in radii)
        comments.append(f"The plugin has one radius: make the left wheel's collision {left} m, the right's {right} m.")
    sizes = {"wheel_separation": track, "wheel_base" if layout == "car" else "wheelbase": axles}
    values = {name: size / separation for name, size in sizes.items() if size} | {"wheel_radius": radius / mean}
    lines = [
        f'<plugin filename="gz-sim-{plugin}-system" name="gz::sim::systems::{name}">',
        *(f"  <{name}>{number(value)}</{name}>" for name, value in values.items()),
        "</plugin>",
    ]
    return _snippet(model, comments, lines, values, _CONSTANTS, represented)


def wheels_snippet(model: MotionModel, base: Base, node: str) -> Snippet:
    """Return the true dimensions as parameters of the controller for the model's wheels.

    diff_drive_controller takes multipliers of its dimensions, the others take the dimensions.
    """
    layout = wheel_layout(model)
    controller, _, _, represented = BASES[layout]
    if layout:
        assumed = "True dimensions, if those in the options are those that were "
        track, axles, radius, separation, *radii = _known(model, base, f"ros2_control: {controller}")
        values = {"traction_wheels_radius": 0.5 * sum(radii) * radius, "wheelbase": axles * separation}
        if layout == "omni":
            names = ("kinematics.wheels_radius", "kinematics.sum_of_robot_center_projection_on_X_Y_axis")
            values = dict(zip(names, (0.5 * sum(radii) * radius, 0.5 * (track + axles) * separation), strict=True))
    else:
        assumed = "True over nominal radii and track, in place of multipliers of 1; multiply them by others that were "
        values = wheel_multipliers(model, base.track)
    comments = [
        f"{assumed}set when the odometry was recorded. They act on the wheel commands, too. Derived in docs/export.md."
    ]
    if any(effect.name == "gyro_scale" and effect.acts for effect in model.effects):
        comments.append(
            "gyro_scale is left out: it is the gain of a heading sensor. Where the heading comes from the wheels it "
            "is wheelbase under another name; call it so in the model file, then it is exported."
        )
    lines = [f"{node}:", "  ros__parameters:", *(f"    {name}: {number(v)}" for name, v in values.items())]
    return _snippet(model, comments, lines, values, _CONSTANTS, represented)


def _known(model: MotionModel, base: Base, program: str) -> tuple[float, ...]:
    """Return track, wheelbase and radius, m, and their multipliers; 0 for those that the model's wheels do not have."""
    layout = wheel_layout(model)
    track = 0.0 if layout in STEERED else base.track if base.track is not None else model.track_m
    sizes = {"--track": track, "--wheelbase": base.wheelbase if layout else 0.0, "--wheel-radius": base.radius}
    known = [size for size in sizes.values() if size is not None]
    if len(known) < len(sizes):
        lacking = ", ".join(option for option, size in sizes.items() if size is None)
        raise ModelError(f"{program} takes dimensions, not multipliers; give {lacking}")
    return (*known, *wheel_multipliers(model, track).values())


def amcl_snippet(model: MotionModel, update_min_d: float, update_min_a: float, turn: Turn, drive: Steady) -> Snippet:
    """Return the alphas, and the update distances at which they apply, as parameters of amcl."""
    reference = "while rolling along an arc" if turn == "rolling" else "on the spot"
    noise, omni = model.noise, wheel_layout(model) == "omni"
    assumed = (
        f"amcl's alphas (variance = alpha x motion^2 per update) with the variances of {noise.words}; "
        f"matched after one update on a straight drive of {update_min_d:g} m and on a turn of {update_min_a:g} rad "
        f"{reference}. They are valid at these update distances only. Derived in docs/export.md."
    )
    comments = [assumed]
    values = amcl_alphas(noise, update_min_d, update_min_a, turn=turn, drive=drive, omni=omni)
    if noise.per_message or noise.coefficients.rot_time:
        comments.append(
            f"The model's noise depends on the message rate: assumed are {drive.speed:g} m/s, "
            f"{drive.yaw_rate:g} rad/s and {drive.rate_hz:g} Hz (--speed, --turn-rate, --rate)."
        )
    if values["alpha5"] and not omni:
        comments.append("Noise across the travel is left out: amcl's differential model does not read alpha5.")
    values |= {"update_min_d": update_min_d, "update_min_a": update_min_a}
    lines = [
        "amcl:",
        "  ros__parameters:",
        f'    robot_model_type: "nav2_amcl::{"Omni" if omni else "Differential"}MotionModel"',
        *(f"    {name}: {number(value)}" for name, value in values.items()),
    ]
    return _snippet(model, comments, lines, values, "amcl assumes unbiased odometry with independent noise")


def twists_snippet(model: MotionModel, drive: Steady, controller: str) -> Snippet:
    """Return the covariance diagonals for the odometry's publisher, and the filter's input configuration."""
    forward, leftward, yaw = twist_variances(model.noise, drive)
    diagonal = (forward, leftward, _UNKNOWN, _UNKNOWN, _UNKNOWN, yaw)
    assumed = (
        f"Variances of the velocities in one message at {drive.speed:g} m/s, {drive.yaw_rate:g} rad/s and "
        f"{drive.rate_hz:g} Hz, of {model.noise.words}. robot_localization reads them from the odometry's "
        f"messages, so they go to the node that publishes these; {number(_UNKNOWN)} stands for what is not measured. "
        "They are valid at this speed and rate only. Derived in docs/export.md."
    )
    lines = [
        f"{controller}:",
        "  ros__parameters:",
        "    twist_covariance_diagonal:",
        f"      [{', '.join(number(value) for value in diagonal)}]",
        "ekf_filter_node:",
        "  ros__parameters:",
        "    # velocities, not poses: the errors of poses accumulate, and a filter treats",
        "    # every message as an independent measurement",
        "    odom0_config: [false, false, false, false, false, false,",
        "                   true, true, false, false, false, true,",
        "                   false, false, false]",
    ]
    values = {f"twist_covariance_diagonal[{i}]": value for i, value in enumerate(diagonal)}
    return _snippet(model, [assumed], lines, values, "the filter assumes unbiased odometry with independent noise")


_CONSTANTS = "its parameters are constants of the wheels"


def _snippet(
    model: MotionModel,
    comments: list[str],
    lines: list[str],
    values: Mapping[str, float],
    why: str,
    represented: frozenset[str] = frozenset(),
) -> Snippet:
    """Return the parameters with a comment on the effects that they cannot represent, all but `represented`."""
    left = [effect for effect in model.effects if effect.acts and effect.name not in represented]
    systematic = ", ".join(effect.name for effect in left if effect.kind != "noise")
    random = ", ".join(effect.name for effect in left if effect.kind == "noise")
    if systematic:
        comments.append(
            f"Cannot be expressed here ({why}): {systematic}. `odomcorrupt correct` takes it out of a recording."
        )
    if random:
        comments.append(f"Cannot be expressed here, nor be corrected, because it is random: {random}.")
    return Snippet(tuple(comments), tuple(lines), values, tuple(effect.name for effect in left))


def number(value: float) -> str:
    """Return a YAML float: ROS distinguishes 1 from 1.0, and YAML 1.1 reads 1e-6 as text."""
    text = f"{value:.6g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{exponent}"
    return text if "." in text else f"{text}.0"

"""Parameters of other programs: variances for robot_localization, alphas for nav2, multipliers for ros2_control.

As numbers, and as YAML with comments on the effects that they cannot represent; docs/export.md derives each formula.
**amcl scales the variance of one update by its squared motion** (Probabilistic Robotics ch. 5.4), with rot1 = 0 on the
spot and rot1 = rot2 = half the turn along an arc.
"""

from __future__ import annotations

import re
import textwrap
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from odomcorrupt.corruption.covariance import FLOOR
from odomcorrupt.effects.unequal_wheels import UnequalWheels
from odomcorrupt.effects.wheel_scale import WheelScale
from odomcorrupt.effects.wheelbase import Wheelbase
from odomcorrupt.errors import ModelError
from odomcorrupt.geometry.increments import Increments
from odomcorrupt.model.noise_laws import variances

if TYPE_CHECKING:
    from collections.abc import Collection

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
    share = 1.0
    dt_s = 1.0 / drive.rate_hz
    moved, turned = drive.speed * dt_s, drive.yaw_rate * dt_s
    if noise.step is not None:
        # a step ends at its distance or at its angle, whichever comes first
        share = max(moved / noise.step.distance_m, turned / noise.step.angle_rad)
        if share == 0.0:
            share, moved, turned = 1.0, 0.0, 0.0
        else:
            moved, turned = moved / share, turned / share
        half = np.array([turned / 2.0])
        v = noise.law.rule(noise.coefficients, half, np.array([moved]), half)
    else:
        v = variances(noise.law, noise.coefficients, Increments(np.array([moved]), np.zeros(1), np.array([turned])))
    k = noise.coefficients
    white = (k.white_omega * dt_s) ** 2 + k.rot_time**2 * dt_s
    return MessageNoise(
        heading=share * float(v.rot1[0] + v.rot2[0]) + white,
        late=share * float(v.rot2[0]) + white / 2.0,
        along=share * float(v.trans[0]) + (k.white_v * dt_s) ** 2,
        across=share * float(v.across[0]),
    )


@dataclass(frozen=True, slots=True)
class TwistVariances:
    """Variances of forward and leftward speed, (m/s)^2, and of the yaw rate, (rad/s)^2."""

    forward: float
    leftward: float
    yaw: float


def twist_variances(noise: Noise, drive: Steady) -> TwistVariances:
    """Return the twist variances in a corrupted message's covariance on this steady drive."""
    message = message_noise(noise, drive)
    moved = drive.speed / drive.rate_hz
    per_s2 = drive.rate_hz**2
    # rot1 and rot2 noise displaces the translation laterally at mid heading; rot1 of an arc does not
    swing = message.late if noise.law.arc else message.heading
    sideways = message.across + 0.25 * swing * (moved**2 + message.along)
    return TwistVariances(message.along * per_s2 + FLOOR, sideways * per_s2 + FLOOR, message.heading * per_s2 + FLOOR)


Turn = Literal["rolling", "spot"]


@dataclass(frozen=True, slots=True)
class AmclAlphas:
    """Alpha1 to alpha5 of nav2, and the motion model they apply to; alpha5 is used by the omnidirectional one only.

    depends_on : rate and speeds assumed, if the model's law depends on them; None otherwise
    """

    alpha1: float
    alpha2: float
    alpha3: float
    alpha4: float
    alpha5: float
    motion_model: str
    depends_on: Steady | None


def amcl_alphas(
    noise: Noise, update_min_d: float, update_min_a: float, *, turn: Turn = "rolling", drive: Steady
) -> AmclAlphas:
    """Return the amcl alphas with the model's variances after one update, for a straight drive and for a turn.

    update_min_d, update_min_a : distance (m) and angle (rad) after which amcl updates its particles
    turn : whether the reference turn is along an arc (`rolling`) or on the spot
    drive : speeds of the straight drive and of the turn, and the odometry's rate, for noise that depends on these
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
    k = noise.coefficients
    stepwise = noise.law.per_step and noise.step is None
    depends_on = drive if stepwise or k.white_v or k.white_omega or k.rot_time else None
    if noise.law.along_travel:
        return AmclAlphas(
            turning.heading * per_a2, straight.heading * per_d2, straight.along * per_d2, turning.along * per_a2,
            straight.across * per_d2, "nav2_amcl::OmniMotionModel", depends_on,
        )  # fmt: skip
    # on a straight line, heading noise is drawn twice (rot1, rot2); a rolling turn is divided into two halves
    halves = 2.0 if turn == "rolling" else 1.0
    return AmclAlphas(
        halves * turning.heading * per_a2, straight.heading * per_d2 / 2.0, straight.along * per_d2,
        halves * turning.along * per_a2, straight.across * per_d2, "nav2_amcl::DifferentialMotionModel", depends_on,
    )  # fmt: skip


WHEEL_EFFECTS = frozenset({WheelScale.name, UnequalWheels.name, Wheelbase.name})
"""Effects that are equivalent to a wrong radius or a wrong track."""


@dataclass(frozen=True, slots=True)
class WheelMultipliers:
    """Ratios of true to nominal wheel separation, left and right radius."""

    separation: float
    left_radius: float
    right_radius: float


def wheel_multipliers(model: MotionModel, track_m: float | None = None) -> WheelMultipliers:
    """Return the multipliers with which a controller computes v = v' + f_along and omega = omega' + f_yaw.

    track_m : nominal distance between the wheels, if the model does not contain it

    Raises
    ------
    ModelError
        If the track is needed and unknown, or a wheel's size would not be positive.
    """
    scale = 1.0 + sum(effect.e for effect in model.effects if isinstance(effect, WheelScale))
    turns = scale - sum(effect.e / (1.0 + effect.e) for effect in model.effects if isinstance(effect, Wheelbase))
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
    return WheelMultipliers(separation, scale - half, scale + half)


_UNKNOWN = 1e6
"""Variance of quantities that a planar robot's odometry does not measure."""
_WIDTH = 80


def condensed(text: str, model: MotionModel) -> str:
    """Return a snippet in flow style, with one comment that names the effects it cannot express."""
    left = unexpressed(text, model)
    said = f"# not expressed: {', '.join(left)} (-v says why)" if left else "# -v says what these numbers assume"
    lines = [said if len(said) <= _WIDTH else "# some effects are not expressed: -v names them"]
    bare = "\n".join(line for line in text.splitlines() if not line.lstrip().startswith("#"))
    for node in re.split(r"\n(?=\S)", bare):
        head, *entries = re.split(r"\n {4}(?=\S)", node)
        name = head.split(":")[0]
        # a key and its number remain on one line
        flow = ", ".join(" ".join(entry.split()).replace(": ", ":\0") for entry in entries)
        lines += textwrap.wrap(f"{name}: {{ros__parameters: {{{flow}}}}}", _WIDTH, subsequent_indent="  ",
                               break_long_words=False, break_on_hyphens=False)  # fmt: skip
    return "\n".join(lines).replace("\0", " ")


def unexpressed(text: str, model: MotionModel) -> list[str]:
    """Return the names of a model's effects that a snippet cannot express, from its comments."""
    return [effect.name for effect in model.effects if effect.acts and effect.name in _comments(text)]


def numbers_of(text: str) -> list[str]:
    """Return a snippet's single-valued parameters as `name value`, and its variances."""
    rows = [line.strip() for line in text.splitlines() if not line.lstrip().startswith("#")]
    single = [tuple(row.split(": ")) for row in rows if ": " in row and "[" not in row and '"' not in row]
    lists = [row.strip("[]") for row in rows if row.startswith("[")]
    return [" ".join(pair) for pair in single] or [f"twist covariance diagonal {row}" for row in lists]


def _comments(text: str) -> str:
    return " ".join(line for line in text.splitlines() if line.startswith("#"))


def wheels_text(model: MotionModel, multipliers: WheelMultipliers, controller: str) -> str:
    """Return the multipliers of diff_drive_controller as YAML."""
    lines = _comment(
        "True over nominal wheel radii and track. They replace multipliers of 1; multiply them by others that were "
        "set when the odometry was recorded. They act on the wheel commands, too. Derived in docs/export.md."
    )
    if any(effect.name == "gyro_scale" and effect.acts for effect in model.effects):
        lines += _comment(
            "gyro_scale is left out: it is the gain of a heading sensor. Where the heading comes from the wheels it "
            "is wheelbase under another name; call it so in the model file, then it is exported."
        )
    lines += _left_out(model, WHEEL_EFFECTS | {"gyro_scale"}, "the controller's parameters are constants of the wheels")
    return _yaml(
        lines,
        f"{controller}:",
        "  ros__parameters:",
        f"    wheel_separation_multiplier: {_number(multipliers.separation)}",
        f"    left_wheel_radius_multiplier: {_number(multipliers.left_radius)}",
        f"    right_wheel_radius_multiplier: {_number(multipliers.right_radius)}",
    )


def amcl_text(model: MotionModel, alphas: AmclAlphas, update_min_d: float, update_min_a: float, turn: str) -> str:
    """Return the alphas of amcl, and the update distances at which they apply, as YAML."""
    reference = "while rolling along an arc" if turn == "rolling" else "on the spot"
    lines = _comment(
        f"amcl's alphas (variance = alpha x motion^2 per update) with the variances of {model.noise.words}; "
        f"matched after one update on a straight drive of {update_min_d:g} m and on a turn of {update_min_a:g} rad "
        f"{reference}. They are valid at these update distances only. Derived in docs/export.md."
    )
    if alphas.depends_on is not None:
        drive = alphas.depends_on
        lines += _comment(
            f"The model's noise depends on the message rate: assumed are {drive.speed:g} m/s, "
            f"{drive.yaw_rate:g} rad/s and {drive.rate_hz:g} Hz (--speed, --turn-rate, --rate)."
        )
    if alphas.alpha5 and "Differential" in alphas.motion_model:
        lines += _comment("Noise across the travel is left out: amcl's differential model does not read alpha5.")
    lines += _left_out(model, frozenset(), "amcl assumes unbiased odometry with independent noise")
    values = (alphas.alpha1, alphas.alpha2, alphas.alpha3, alphas.alpha4, alphas.alpha5)
    return _yaml(
        lines,
        "amcl:",
        "  ros__parameters:",
        f'    robot_model_type: "{alphas.motion_model}"',
        *(f"    alpha{i}: {_number(value)}" for i, value in enumerate(values, start=1)),
        f"    update_min_d: {_number(update_min_d)}",
        f"    update_min_a: {_number(update_min_a)}",
    )


def twists_text(model: MotionModel, variances: TwistVariances, drive: Steady, controller: str) -> str:
    """Return the covariance diagonals for the odometry's publisher and the filter's input configuration, as YAML."""
    unknown = _number(_UNKNOWN)
    diagonal = (variances.forward, variances.leftward, _UNKNOWN, _UNKNOWN, _UNKNOWN, variances.yaw)
    lines = _comment(
        f"Variances of the velocities in one message at {drive.speed:g} m/s, {drive.yaw_rate:g} rad/s and "
        f"{drive.rate_hz:g} Hz, of {model.noise.words}. robot_localization reads them from the odometry's "
        f"messages, so they go to the node that publishes these; {unknown} stands for what is not measured. They are "
        "valid at this speed and rate only. Derived in docs/export.md."
    )
    lines += _left_out(model, frozenset(), "the filter assumes unbiased odometry with independent noise")
    return _yaml(
        lines,
        f"{controller}:",
        "  ros__parameters:",
        "    twist_covariance_diagonal:",
        f"      [{', '.join(_number(value) for value in diagonal)}]",
        "ekf_filter_node:",
        "  ros__parameters:",
        "    # velocities, not poses: the errors of poses accumulate, and a filter treats",
        "    # every message as an independent measurement",
        "    odom0_config: [false, false, false, false, false, false,",
        "                   true, true, false, false, false, true,",
        "                   false, false, false]",
    )


def _left_out(model: MotionModel, said: Collection[str], why: str) -> list[str]:
    """Return comments on effects that these parameters cannot represent."""
    left = [effect for effect in model.effects if effect.acts and effect.name not in said]
    systematic = [effect.name for effect in left if effect.kind != "noise"]
    random = [effect.name for effect in left if effect.kind == "noise"]
    lines = []
    if systematic:
        lines += _comment(
            f"Cannot be expressed here ({why}): {', '.join(systematic)}. `odomcorrupt correct` takes it out of a "
            "recording."
        )
    if random:
        lines += _comment(f"Cannot be expressed here, nor be corrected, because it is random: {', '.join(random)}.")
    return lines


def _comment(sentence: str) -> list[str]:
    return textwrap.wrap(sentence, _WIDTH, initial_indent="# ", subsequent_indent="# ", break_on_hyphens=False)


def _yaml(comments: list[str], *lines: str) -> str:
    return "\n".join([*comments, *lines])


def _number(value: float) -> str:
    """Return a YAML float: ROS distinguishes 1 from 1.0, and YAML 1.1 reads 1e-6 as text."""
    text = f"{value:.6g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{exponent}"
    return text if "." in text else f"{text}.0"

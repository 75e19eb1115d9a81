"""YAML snippets for other programs, with comments on effects that they cannot represent."""

from __future__ import annotations

import re
import textwrap
from typing import TYPE_CHECKING

from odomcorrupt.export.parameters import WHEEL_EFFECTS, WheelMultipliers
from odomcorrupt.sampling.text import law_words

if TYPE_CHECKING:
    from collections.abc import Collection

    from odomcorrupt.export.parameters import AmclAlphas, Steady, TwistVariances
    from odomcorrupt.model.motion_model import MotionModel

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
        f"amcl's alphas (variance = alpha x motion^2 per update) with the variances of {law_words(model.noise)}; "
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
        f"{drive.rate_hz:g} Hz, of {law_words(model.noise)}. robot_localization reads them from the odometry's "
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

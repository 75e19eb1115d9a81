"""Alphas of nav2's amcl with the same drift as a model's noise law, at amcl's update distances.

**amcl scales the variance of one update by its squared motion** (Probabilistic Robotics ch. 5.4), with rot1 = 0 on the
spot and rot1 = rot2 = half the turn along an arc.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from odomcorrupt.errors import ModelError
from odomcorrupt.export.robot_localization import Steady, message_noise

if TYPE_CHECKING:
    from odomcorrupt.model.motion_model import Noise

__all__ = ["AmclAlphas", "Turn", "amcl_alphas"]

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
    depends_on = drive if stepwise or k.white_v or k.white_omega else None
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

"""The alphas of nav2's amcl that make, at its update distances, the drift of a model's law.

**amcl scales the variance of one update by its squared motion** (Probabilistic Robotics ch. 5.4), with rot1 = 0 on the
spot and rot1 = rot2 = half the turn while rolling along an arc.
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
    """Alpha1..5 in nav2's sense, and for which of its motion models; alpha5 matters to the omnidirectional one alone.

    drift_depends_on : rate and speeds that were assumed because the model's law depends on them; None: on nothing
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
    """Return the alphas whose variances after one update are the model's: of a straight drive, and of a turn.

    Parameters
    ----------
    update_min_d, update_min_a
        Metres and radians after which amcl moves its particles.
    turn
        Whether the reference turn is driven while rolling along an arc, or on the spot.
    drive
        Speeds of the straight drive and of the turn, and the odometry's rate, for noise that depends on these.

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
    # the straight's heading noise is drawn twice, before and after; a rolling turn falls into two halves
    halves = 2.0 if turn == "rolling" else 1.0
    return AmclAlphas(
        halves * turning.heading * per_a2, straight.heading * per_d2 / 2.0, straight.along * per_d2,
        halves * turning.along * per_a2, straight.across * per_d2, "nav2_amcl::DifferentialMotionModel", depends_on,
    )  # fmt: skip

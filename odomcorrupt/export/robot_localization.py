"""Velocity variances of one odometry message on a steady drive, for robot_localization."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.covariance import FLOOR
from odomcorrupt.errors import ModelError
from odomcorrupt.geometry.increments import Increments
from odomcorrupt.model.noise_laws import variances

if TYPE_CHECKING:
    from odomcorrupt.model.motion_model import Noise

__all__ = ["MessageNoise", "Steady", "TwistVariances", "message_noise", "twist_variances"]


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
    white = (k.white_omega * dt_s) ** 2
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

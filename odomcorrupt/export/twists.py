"""Variances of the velocities in one odometry message, as filters read them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from odomcorrupt.corruption.covariance import FLOOR
from odomcorrupt.export.step_variance import Steady, message_noise

if TYPE_CHECKING:
    from odomcorrupt.model.motion_model import Noise

__all__ = ["TwistVariances", "twist_variances"]


@dataclass(frozen=True, slots=True)
class TwistVariances:
    """Of forward and leftward speed, (m/s)^2, and of the yaw rate, (rad/s)^2."""

    forward: float
    leftward: float
    yaw: float


def twist_variances(noise: Noise, drive: Steady) -> TwistVariances:
    """Return the variances that a corrupted message's covariance would hold on this steady drive."""
    message = message_noise(noise, drive)
    moved = drive.speed / drive.rate_hz
    per_s2 = drive.rate_hz**2
    # turns before and after the translation shift it to one side, seen at mid heading; the first one of an arc does not
    swing = message.late if noise.law.arc else message.heading
    sideways = message.across + 0.25 * swing * (moved**2 + message.along)
    return TwistVariances(message.along * per_s2 + FLOOR, sideways * per_s2 + FLOOR, message.heading * per_s2 + FLOOR)

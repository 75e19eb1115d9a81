"""Wheel radius and separation multipliers of diff_drive_controller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from odomcorrupt.effects.unequal_wheels import UnequalWheels
from odomcorrupt.effects.wheel_scale import WheelScale
from odomcorrupt.effects.wheelbase import Wheelbase
from odomcorrupt.errors import ModelError

if TYPE_CHECKING:
    from odomcorrupt.model.motion_model import MotionModel

__all__ = ["WHEEL_EFFECTS", "WheelMultipliers", "wheel_multipliers"]

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
            "unequal_wheels: its curvature tells the radii apart only with the distance between the wheels; "
            "give --track, or write [robot] track in the model file"
        )
    if not (scale > 0.0 and turns > 0.0):
        raise ModelError(f"wheel_scale and wheelbase: radius times {scale:g}, turns times {turns:g}; no robot is that")
    separation = scale / turns
    half = 0.5 * curvature * separation * (track or 0.0)
    if not abs(half) < scale:
        raise ModelError(f"unequal_wheels: curvature {curvature:g} rad/m leaves one wheel no radius on {track} m")
    return WheelMultipliers(separation, scale - half, scale + half)

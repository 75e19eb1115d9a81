"""What single wheels do: rim speeds of the two sides, and back."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from odomcorrupt.effects.effect import Motion, choice, stacked
from odomcorrupt.errors import EffectError

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

__all__ = ["Rims", "body_of", "heading_choice", "needed_track_m", "rims_of", "turning", "wheel_motions"]


def heading_choice() -> Any:
    """Declare where the odometry's heading comes from: with a gyro, what the wheels do wrong is wrong along alone."""
    return choice("source of the odometry's heading; what wheels do wrong does not turn a gyro", "wheels", "gyro")


def turning(heading: str, yaw: Array) -> Array:
    """Return how much an error of the wheels turns the odometry, rad/s or rad, of what it would turn their heading."""
    return yaw if heading == "wheels" else np.zeros_like(yaw)


class Rims(NamedTuple):
    """Something per wheel, (n,) each: speeds in m/s or travel in m."""

    right: Array
    left: Array


def needed_track_m(name: str, track_m: float | None) -> float:
    """Return the track; EffectError where it is not known."""
    if track_m is None:
        raise EffectError(
            f"effect {name}: acts on single wheels and the track is not known; give it in metres with --track, or as "
            "[robot] track = 0.4 in a model file"
        )
    return track_m


def rims_of(along: Array, yaw: Array, track_m: float) -> Rims:
    """Return what the two wheels do where the body moves along and turns, speeds or travel."""
    half = 0.5 * track_m * yaw
    return Rims(along + half, along - half)


def body_of(rims: Rims, track_m: float, heading: str = "wheels") -> Array:
    """Return what the odometry does, (n, 3), where the wheels do this."""
    yaw = turning(heading, (rims.right - rims.left) / track_m)
    return stacked(0.5 * (rims.right + rims.left), 0.0, yaw, rims.right)


def wheel_motions(motion: Motion, track_m: float) -> tuple[Motion, Motion]:
    """Return the motion of the right wheel and of the left one: its rim speed, its acceleration and its place.

    Turn, time and distance are the body's.
    """
    right, left = (_at_wheel(motion, 0.5 * track_m * side) for side in (1.0, -1.0))
    return right, left


def _at_wheel(motion: Motion, arm_m: float) -> Motion:
    """Return the motion so far to the right of the middle."""

    def there(rates: Array) -> Array:
        return rates + arm_m * rates[..., 2:] * [1.0, 0.0, 0.0]  # what turns moves on, too

    return replace(
        motion,
        v=motion.v + arm_m * motion.omega,
        acceleration=there(motion.acceleration),
        x=motion.x + arm_m * np.sin(motion.theta),
        y=motion.y - arm_m * np.cos(motion.theta),
        trail=None if motion.trail is None else there(motion.trail),
        before=None if motion.before is None else there(motion.before),
    )

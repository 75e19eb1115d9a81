"""Rim speeds of the two sides, and effects of single wheels."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

import numpy as np

from odomcorrupt.effects.effect import Effect, Motion, choice, parameter, parameters, stacked
from odomcorrupt.errors import EffectError

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.geometry.se2 import Array

TRACKS_M = (0.12, 0.22, 0.4, 0.7, 1.2)
"""Trial tracks of an effect of single wheels, metres, if the robot's track is unknown."""
E = TypeVar("E", bound=Effect)


def track_parameter() -> Any:
    """Return the field of the track of an effect of single wheels, a nuisance that is estimated if it is unknown."""
    return parameter(
        "m", "distance between the wheels, where that of the robot is not known; 0: the robot's own", low=0.0, high=3.0,
        typical=0.3, amplitude=False, optional=True,
    )  # fmt: skip


def brings_track(kind: type[Effect] | Effect) -> bool:
    """Return whether an effect of single wheels can be tried without a known track, i.e. has a parameter `track`."""
    return any(p.name == "track" and p.optional for p in parameters(kind))


def on_every_track(effects: Sequence[E], motions: Sequence[Motion]) -> tuple[E, ...]:
    """Return the effects unchanged if the robot's track is known; otherwise one copy for each trial track."""
    if all(m.track_m is not None for m in motions):
        return tuple(effects)
    return tuple(replace(effect, track=track_m) for effect in effects for track_m in TRACKS_M)  # type: ignore[type-var]


def heading_choice() -> Any:
    """Return the field of the source of the heading: with a gyro, wheel errors change only the forward motion."""
    return choice("source of the odometry's heading; wheel errors do not affect a gyro", "wheels", "gyro")


def turning(heading: str, yaw: Array) -> Array:
    """Return the yaw error (rad/s or rad) of the odometry due to the wheels: `yaw`, or zero with a gyro."""
    return yaw if heading == "wheels" else np.zeros_like(yaw)


class Rims(NamedTuple):
    """A quantity per wheel, (n,) each: speeds in m/s or travel in m."""

    right: Array
    left: Array


def scaled(motion: Motion, part: Array | float, heading: str) -> tuple[Array, Array, Array]:
    """Return f along, across and in yaw, (n,) each, of a twist that is wrong by a part of it; no yaw with a gyro."""
    return part * motion.v, part * motion.vy, turning(heading, part * motion.omega)


def needed_track_m(effect: Effect, track_m: float | None) -> float:
    """Return the effect's own track if it has one, or else the robot's; raise EffectError if neither is known."""
    track_m = getattr(effect, "track", 0.0) or track_m
    if track_m is None:
        raise EffectError(
            f"effect {effect.name}: acts on single wheels and the track is not known; give it in metres with --track, "
            "or as [robot] track = 0.4 in a model file"
        )
    return track_m


def rims_of(along: Array, yaw: Array, track_m: float) -> Rims:
    """Return the speeds (m/s) or travel (m) of both rims for a body that moves forward and turns.

    along, yaw : (n,) forward speed and yaw rate, or travel and turn
    track_m : distance between the wheels
    """
    half = 0.5 * track_m * yaw
    return Rims(along + half, along - half)


def body_of(rims: Rims, track_m: float, heading: str = "wheels") -> Array:
    """Return the odometry's motion (n, 3), forwards, to the left and of the yaw, for motions of the rims.

    rims : speeds (m/s) or travel (m)
    track_m : distance between the wheels
    heading : source of the odometry's heading, "wheels" or "gyro"; with a gyro the yaw is zero
    """
    yaw = turning(heading, (rims.right - rims.left) / track_m)
    return stacked(0.5 * (rims.right + rims.left), 0.0, yaw, rims.right)


def error_of_each_wheel(error: Callable[[Array], Array], v: Array, omega: Array, track_m: float | None) -> Array:
    """Return f (n, 3) of an error of each wheel by its speed; without a track, its limit for the body.

    error : function of rim speeds (n,), m/s, to their errors (n,), m/s
    v, omega : (n,) speed and yaw rate of the odometry
    track_m : distance between the wheels; None if it is not known
    """
    if track_m is not None:
        return body_of(Rims(*(error(u) for u in rims_of(v, omega, track_m))), track_m)
    part = np.divide(error(v), v, out=np.zeros_like(v), where=v != 0.0)
    return stacked(part * v, 0.0, part * omega, v)


def trial_speeds(
    motions: Sequence[Motion], quantile: float, parts: Sequence[float], low: float, high: float
) -> list[float]:
    """Return parts of a quantile of the speeds at which the robots move, within bounds, m/s; none if they stand."""
    speeds = np.abs(np.concatenate([m.v for m in motions]))
    moving = speeds[speeds > 1e-6]
    return np.clip(np.multiply(parts, np.quantile(moving, quantile)), low, high).tolist() if len(moving) else []


@lru_cache(maxsize=4)  # a shape search needs the same ones a thousand times
def wheel_motions(motion: Motion, track_m: float) -> tuple[Motion, Motion]:
    """Return the motion of the right wheel and of the left one: rim speed, acceleration and position.

    Rotation, time and distance are the body's.
    """
    right, left = (_at_wheel(motion, 0.5 * track_m * side) for side in (1.0, -1.0))
    return right, left


def _at_wheel(motion: Motion, arm_m: float) -> Motion:
    """Return the motion of a point this far to the right of the middle."""

    def there(rates: Array) -> Array:
        moved = rates.copy()
        moved[..., 0] += arm_m * rates[..., 2]  # a rotation also moves a point off the middle
        return moved

    return replace(
        motion,
        v=motion.v + arm_m * motion.omega,
        acceleration=there(motion.acceleration),
        x=motion.x + arm_m * np.sin(motion.theta),
        y=motion.y - arm_m * np.cos(motion.theta),
        trail=None if motion.trail is None else there(motion.trail),
        before=None if motion.before is None else there(motion.before),
    )

"""Geometry of steering effects: curvature of a path, the tangent of large steering angles, and a driven front wheel."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from odomcorrupt.effects.effect import Effect, choice, choices, parameter, stacked

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.motion import Motion
    from odomcorrupt.geometry.se2 import Array

CREEP_MPS = 0.05 - 1e-9
"""Speed below which a path does not show the steering angle, m/s; just below a round 0.05, which rounding may reach."""
_STEEP = (0.3, 0.55)
"""Tangents of the largest steering angle that give trial distances between the axles: 17 and 29 degrees."""
_STEEPER = (0.55, 2.0)
"""The same where the steered wheel is driven, which turns further: 29 and 63 degrees."""
_TIGHTEST = 0.99
_LOCK_RAD = 1.4
"""Steering angle beyond which its tangent is no path of a car."""

E = TypeVar("E", bound=Effect)


def axles_parameter() -> Any:
    """Return the field of the distance between the axles, a nuisance: the tangent of large steering angles needs it."""
    return parameter(
        "m", "distance between the axles, where steering angles are large; 0: they are small", low=0.0, high=20.0,
        typical=0.5, amplitude=False, optional=True,
    )  # fmt: skip


def driven_choice() -> Any:
    """Return the field of the wheel whose travel is measured: that of a steered one is only in part along the robot."""
    return choice("wheel that is driven and counted; the front one is steered, and needs axles", "rear", "front")


def on_every_axle_distance(effect: E, motions: Sequence[Motion]) -> tuple[E, ...]:
    """Return the effect for small steering angles, and for each trial distance between the axles."""
    v, omega = (np.abs(np.concatenate([getattr(m, name) for m in motions])) for name in ("v", "omega"))
    turning = v > CREEP_MPS
    largest = float(np.quantile(omega[turning] / v[turning], _TIGHTEST)) if turning.any() else 0.0
    if not largest > 0.0:
        return (effect,)
    trials: list[dict[str, Any]] = [{"axles": min(tangent / largest, 20.0)} for tangent in _STEEP]
    if "driven" in choices(effect):
        trials += [{"axles": min(tangent / largest, 20.0), "driven": "front"} for tangent in _STEEPER]
    return (effect, *(replace(effect, **trial) for trial in trials))  # type: ignore[type-var]


def steepness(v: Array, omega: Array, axles_m: float) -> Array:
    """Return the tangent (n,) of the steering angle, clipped to 0..1; 0 if the robot hardly travels.

    v, omega : (n,) speed, m/s, and yaw rate, rad/s
    axles_m : distance between the axles
    """
    tangent = np.divide(axles_m * np.abs(omega), np.abs(v), out=np.zeros_like(v), where=np.abs(v) > CREEP_MPS)
    return np.minimum(tangent, 1.0)


def steered(curvature: Array, axles_m: float) -> Array:
    """Return the steering angles (n,) of a path per distance between the axles, rad/m; without it angles are small."""
    return np.arctan(axles_m * curvature) / axles_m if axles_m else curvature


def curvature_at(angle: Array, axles_m: float) -> Array:
    """Return the curvatures (n,), 1/m, of a path steered with angles of `steered`, rad/m."""
    return np.tan(np.clip(axles_m * angle, -_LOCK_RAD, _LOCK_RAD)) / axles_m if axles_m else angle


def turned_front(v: Array, omega: Array, angle: Array | float, axles_m: float) -> Array:
    """Return f (n, 3) of a steered wheel whose travel is measured and that points further left by axles_m * angle.

    Its velocity (v, axles_m omega) is turned; angle (n,) in rad/m, as of `steered`.
    """
    if not axles_m:
        return stacked(0.0, 0.0, angle * v, v)
    sideways = axles_m * omega
    less, sine = np.cos(axles_m * angle) - 1.0, np.sin(axles_m * angle)
    return stacked(less * v - sine * sideways, 0.0, (less * sideways + sine * v) / axles_m, v)

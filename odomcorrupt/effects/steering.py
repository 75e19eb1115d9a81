"""Geometry of steering effects: curvature of a path, and the tangent of large steering angles."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np

from odomcorrupt.effects.effect import Effect, parameter

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.motion import Motion
    from odomcorrupt.geometry.se2 import Array

CREEP_MPS = 0.05 - 1e-9
"""Speed below which a path does not show the steering angle, m/s; just below a round 0.05, which rounding may reach."""
_STEEP = (0.3, 0.55)
"""Tangents of the largest steering angle that give trial distances between the axles: 17 and 29 degrees."""
_TIGHTEST = 0.99
_LOCK_RAD = 1.4
"""Steering angle beyond which its tangent is no path of a car."""

E = TypeVar("E", bound=Effect)


def axles_parameter() -> Any:
    """Declare the distance between the axles, a nuisance: the tangent of a large steering angle depends on it."""
    return parameter(
        "m", "distance between the axles, where steering angles are large; 0: they are small", low=0.0, high=20.0,
        typical=0.5, amplitude=False, optional=True,
    )  # fmt: skip


def on_every_axle_distance(effect: E, motions: Sequence[Motion]) -> tuple[E, ...]:
    """Return the effect for small steering angles, and for each trial distance between the axles."""
    v, omega = (np.abs(np.concatenate([getattr(m, name) for m in motions])) for name in ("v", "omega"))
    turning = v > CREEP_MPS
    largest = float(np.quantile(omega[turning] / v[turning], _TIGHTEST)) if turning.any() else 0.0
    found = [min(tangent / largest, 20.0) for tangent in _STEEP] if largest > 0.0 else []
    return (effect, *(replace(effect, axles=axles) for axles in found))  # type: ignore[type-var]


def steepness(v: Array, omega: Array, axles_m: float) -> Array:
    """Return the tangent (n,) of the steering angle, clipped to 0..1; 0 if the robot hardly travels."""
    tangent = np.divide(axles_m * np.abs(omega), np.abs(v), out=np.zeros_like(v), where=np.abs(v) > CREEP_MPS)
    steep: Array = np.minimum(tangent, 1.0)
    return steep


def steered(curvature: Array, axles_m: float) -> Array:
    """Return the steering angles (n,) of a path per distance between the axles, rad/m; without it angles are small."""
    return np.arctan(axles_m * curvature) / axles_m if axles_m else curvature


def curvature_at(angle: Array, axles_m: float) -> Array:
    """Return the curvatures (n,), 1/m, of a path steered with angles of `steered`, rad/m."""
    return np.tan(np.clip(axles_m * angle, -_LOCK_RAD, _LOCK_RAD)) / axles_m if axles_m else angle

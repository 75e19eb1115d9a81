"""Time window of an event: its parameters, and the fraction of each interval inside it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.effects.effect import parameter

if TYPE_CHECKING:
    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.geometry.se2 import Array


def time_parameter() -> Any:
    """Return the field of the time at which an event begins."""
    return parameter(
        "s", "when it begins, after the first odometry stamp", low=0.0, high=1e6, typical=5.0, identity=5.0,
        amplitude=False,
    )  # fmt: skip


def duration_parameter(typical_s: float) -> Any:
    """Return the field of the duration of an event, as a shape: another parameter is its amplitude."""
    return parameter(
        "s", "how long it lasts", low=0.01, high=1e4, typical=typical_s, identity=typical_s, amplitude=False
    )


def part_inside(motion: Motion, begin_s: float, end_s: float) -> Array:
    """Return the fraction (n,) of each interval that lies between two times; 0 for an interval of no length.

    begin_s, end_s : seconds after the first odometry stamp
    """
    inside = np.minimum(motion.t_s, end_s) - np.maximum(motion.t_s - motion.dt_s, begin_s)
    return np.divide(np.maximum(inside, 0.0), motion.dt_s, out=np.zeros_like(motion.dt_s), where=motion.dt_s > 0.0)

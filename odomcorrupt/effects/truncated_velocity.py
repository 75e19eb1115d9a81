"""Velocities truncated to whole steps before odometry is computed from them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import (
    About,
    Effect,
    Motion,
    Recorded,
    State,
    TwistError,
    parameter,
    stacked,
)

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

_LONG_S = 3600.0
_STILL = 0.02
"""Speed, m/s and rad/s, over which the sign of a smooth speed fades: a standing robot sways by about as much."""


@dataclass(frozen=True, slots=True)
class TruncatedVelocity(Effect):
    """f = (step sign(v) / 2, 0, turn sign(omega) / 2): on average half a step is truncated towards zero.

    Corruption truncates speeds to whole steps. The report does not show the remainder, so correction adds its mean.
    Towards rest the sign fades as u / sqrt(u^2 + 0.02^2).
    """

    name = "truncated_velocity"
    odd = True
    layer = "record"
    summary = "velocities are cut down to whole steps before they are summed up"
    about = About(
        equation="reported v = step trunc(v / step); on average f = (step sign(v) / 2, 0, turn sign(omega) / 2)",
        typical="steps of 1 to 50 mm/s and 0.01 to 0.1 rad/s, of integers in a serial protocol (an estimate)",
        source="rounding towards zero, as an integer cast in C does (ISO/IEC 9899, 6.3.1.4)",
        confused_with=("dead_band", "wheel_scale", "counts_lost"),
        drive="the same straight, and turns on the spot, very slowly and fast",
    )

    step: float = parameter("m/s", "step of the forward speed", low=0.0, high=0.5, typical=0.02)
    turn: float = parameter("rad/s", "step of the yaw rate", low=0.0, high=1.0, typical=0.05)

    @property
    def lost_m(self) -> float:
        """Bound on the uncorrectable error: the odometry does not show the truncated part, between zero and a step."""
        return sum(self.remainder) * _LONG_S

    @property
    def remainder(self) -> tuple[float, float]:
        """Half a step, the largest difference between the truncated part and its mean."""
        return 0.5 * self.step, 0.5 * self.turn

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: half a step in the direction of the motion."""
        along, yaw = (
            0.5 * size * u / np.hypot(u, _STILL) for size, u in ((self.step, motion.v), (self.turn, motion.omega))
        )
        return TwistError(stacked(along, 0.0, yaw, motion.v), state)

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - no wheels
        """Return increments with speeds truncated to whole steps."""
        last_s = float(t_s[-1]) if len(t_s) else state
        dt = np.diff(t_s, prepend=0.0 if state is None else state)
        cut = steps.copy()
        for column, size in ((0, self.step), (2, self.turn)):
            if size > 0.0:
                whole = size * dt
                counted = np.divide(steps[:, column], whole, out=np.zeros_like(dt), where=dt > 0.0)
                cut[:, column] = np.where(dt > 0.0, whole * np.trunc(counted), steps[:, column])
        return Recorded(cut, last_s)

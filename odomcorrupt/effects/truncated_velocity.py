"""Velocities truncated to whole steps before odometry is computed from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import (
    About,
    Effect,
    Motion,
    Recorded,
    State,
    TwistError,
    choice,
    parameter,
    stacked,
)

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

_LONG_S = 3600.0
_STILL = 0.002
"""Speed, m/s and rad/s, over which the sign of a speed fades: below the steps of serial protocols."""
_NEAR_S = 0.5
"""Window of the mean speed whose direction a correction takes: a slow turn is reported as zeros between single steps."""


@dataclass(frozen=True, slots=True)
class TruncatedVelocity(Effect):
    """f = (step sign(v) / 2, 0, turn sign(omega) / 2): on average half a step is truncated towards zero.

    With rounding = down, half a step is lost upwards in both directions. Corruption truncates speeds to whole steps.
    The report does not show the remainder, so correction adds its mean, in the direction of the mean speed around each
    moment. Towards rest the sign fades as u / sqrt(u^2 + 0.002^2).
    """

    name = "truncated_velocity"
    odd = True
    layer = "record"
    summary = "velocities are cut down to whole steps before they are summed up"
    about = About(
        equation="reported v = step trunc(v / step); on average f = (step sign(v) / 2, 0, turn sign(omega) / 2)",
        typical="steps of 1 to 50 mm/s and 0.01 to 0.1 rad/s, of integers in a serial protocol (an estimate)",
        source="rounding towards zero, as an integer cast in C does (ISO/IEC 9899, 6.3.1.4); down, as // in Python",
        confused_with=("dead_band", "wheel_scale", "counts_lost"),
        drive="the same straight, and turns on the spot, very slowly and fast",
    )

    step: float = parameter("m/s", "step of the forward speed", low=0.0, high=0.5, typical=0.02)
    turn: float = parameter("rad/s", "step of the yaw rate", low=0.0, high=1.0, typical=0.05)
    rounding: str = choice("to which side speeds are rounded: towards zero, or down", "zero", "down")

    @property
    def lost_m(self) -> float:
        """Bound on the uncorrectable error: the odometry does not show the truncated part, between zero and a step."""
        return sum(self.remainder) * _LONG_S

    @property
    def remainder(self) -> tuple[float, float]:
        """Half a step, the largest difference between the truncated part and its mean."""
        return 0.5 * self.step, 0.5 * self.turn

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: half a step in the direction of the motion, or upwards while a speed is reported."""
        along, yaw = (
            0.5 * size * self._side(u / np.hypot(u, _STILL))
            for size, u in ((self.step, motion.v), (self.turn, motion.omega))
        )
        return TwistError(stacked(along, 0.0, yaw, motion.v), state)

    def _side(self, sign: Array) -> Array:
        return sign if self.rounding == "zero" else sign**2

    def restored(self, motion: Motion) -> Motion:
        """Return the motion plus f of the mean speeds around each moment, unless the odometry reports rest."""
        moving = (motion.v != 0.0) | (motion.omega != 0.0)
        mean = replace(motion, v=_mean_around(motion.v, motion.dt_s), omega=_mean_around(motion.omega, motion.dt_s))
        f = self.twist_error(mean, None).f * moving[:, None]
        return replace(motion, v=motion.v + f[:, 0], omega=motion.omega + f[:, 2])

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - no wheels
        """Return increments with speeds truncated to whole steps."""
        last_s = float(t_s[-1]) if len(t_s) else state
        dt = np.diff(t_s, prepend=0.0 if state is None else state)
        cut = steps.copy()
        cut_to = np.trunc if self.rounding == "zero" else np.floor
        for column, size in ((0, self.step), (2, self.turn)):
            if size > 0.0:
                whole = size * dt
                counted = np.divide(steps[:, column], whole, out=np.zeros_like(dt), where=dt > 0.0)
                cut[:, column] = np.where(dt > 0.0, whole * cut_to(counted), steps[:, column])
        return Recorded(cut, last_s)


def _mean_around(speed: Array, dt_s: Array) -> Array:
    """Return the mean (n,) of a speed in windows of `_NEAR_S` around the middle of each interval."""
    ends_s = np.concatenate(([0.0], np.cumsum(dt_s)))
    travel = np.concatenate(([0.0], np.cumsum(speed * dt_s)))
    middle_s = (ends_s[:-1] + ends_s[1:]) / 2.0
    first, last = (np.clip(middle_s + side * _NEAR_S / 2.0, 0.0, ends_s[-1]) for side in (-1.0, 1.0))
    mean: Array = (np.interp(last, ends_s, travel) - np.interp(first, ends_s, travel)) / np.maximum(last - first, 1e-9)
    return mean

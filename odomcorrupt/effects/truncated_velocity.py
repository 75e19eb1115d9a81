"""Velocities truncated to whole steps before odometry is computed from them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

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
from odomcorrupt.effects.wheels import Rims, body_of, rims_of
from odomcorrupt.geometry.speed_steps import lost_parts, speed_steps

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array

_LONG_S = 3600.0
_STILL = 0.02
"""Speed, m/s and rad/s, over which the sign of a speed fades: a standing robot sways by about as much. With a tenth of
it, noise of the odometry biased the fitted steps of clean drives by two standard errors."""
_STILL_MEAN = 0.002
"""The same for mean speeds, which have less noise: below the steps of serial protocols."""
_NEAR_S = 0.5
"""Window of the mean speed that a correction reads, seconds: slow turns are reported as single steps among zeros."""
_TICKS = (0.15, 1.0, 0.01)
"""Trial ticks: least and largest, as multiples of the ticks that equal a step, and their relative spacing, by which the
beats of two neighbours hardly differ within the tens of steps of usual speeds."""


@dataclass(frozen=True, slots=True)
class TruncatedVelocity(Effect):
    """f = (step sign(v) / 2, 0, turn sign(omega) / 2): on average half a step is truncated towards zero.

    With rounding = down, it is lost upwards in both directions. Corruption truncates speeds to whole steps. The report
    does not show the remainder, so correction adds its mean, which it reads from the mean speed around each moment.
    Towards rest the sign fades as u / sqrt(u^2 + 0.02^2).

    If speeds are counts of encoder ticks in a loop, they come in steps before the truncation already, and each reported
    step loses another part (`tick`). The steps themselves are then those that the odometry shows.
    """

    name = "truncated_velocity"
    odd = True
    layer = "record"
    summary = "velocities are truncated to whole steps before they are integrated"
    about = About(
        equation="reported v = step trunc(v / step); on average f = (step sign(v) / 2, 0, turn sign(omega) / 2)",
        typical="steps of 1 to 50 mm/s and 0.01 to 0.1 rad/s, of integers in a serial protocol (an estimate)",
        source="rounding towards zero, as an integer cast in C does (ISO/IEC 9899, 6.3.1.4); down, as // in Python",
        confused_with=("dead_band", "wheel_scale", "counts_lost"),
        drive="the same straight, and turns on the spot, very slowly and fast",
    )

    step: float = parameter("m/s", "step of the forward speed", low=0.0, high=0.5, typical=0.02)
    turn: float = parameter("rad/s", "step of the yaw rate", low=0.0, high=1.0, typical=0.05)
    tick: float = parameter(
        "m/s", "rim speed of one encoder tick per loop, if ticks are counted before", low=0.0, high=0.5, typical=0.01,
        amplitude=False, optional=True,
    )  # fmt: skip
    rounding: str = choice("to which side speeds are rounded: towards zero, or down", "zero", "down")

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:
        """Return the mean over all speeds and, if the odometry shows its steps, the beats of each trial tick."""
        steps, track_m = (motions[0].steps, motions[0].track_m) if len(motions) else (None, None)
        if steps is None or track_m is None:
            return (cls(),)
        ends = np.array((2.0 * steps[0], steps[1] * track_m))
        ticks = np.exp(np.arange(np.log(_TICKS[0] * ends.min()), np.log(_TICKS[1] * ends.max()), _TICKS[2]))
        return (cls(), *(cls(tick=float(tick)) for tick in ticks if tick < 0.5))

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
        return TwistError(self._lost(motion, _STILL), state)

    def _lost(self, motion: Motion, still: float) -> Array:
        """Return the mean (n, 3) of what is truncated; its sign fades over the speed `still`."""
        track_m, steps = motion.track_m, motion.steps
        fades = [u / np.hypot(u, still) for u in (motion.v, motion.omega)]
        if self.rounding == "down":
            lost = [0.5 * fade**2 for fade in fades]
        elif self.tick and track_m is not None and steps is not None:
            lost = [
                part * np.abs(fade)
                for part, fade in zip(lost_parts(motion.v, motion.omega, self.tick, steps, track_m), fades, strict=True)
            ]
        else:
            lost = [0.5 * fade for fade in fades]
        return stacked(self.step * lost[0], 0.0, self.turn * lost[1], motion.v)

    def restored(self, motion: Motion) -> Motion:
        """Return the motion plus f of the mean speeds around each moment, unless the odometry reports rest."""
        moving = (motion.v != 0.0) | (motion.omega != 0.0)
        v, omega = (_mean_around(speed, motion.dt_s) for speed in (motion.v, motion.omega))
        steps = speed_steps(motion.v, motion.omega, motion.dt_s, motion.track_m) if self.tick else None
        mean = replace(motion, v=v, omega=omega, steps=steps)
        f = self._lost(mean, _STILL_MEAN) * moving[:, None]
        return replace(motion, v=motion.v + f[:, 0], omega=motion.omega + f[:, 2])

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:
        """Return increments with speeds truncated to whole steps, of whole ticks if these are counted before."""
        before_s, *phases = state or (0.0, 0.0, 0.0)
        dt = np.diff(t_s, prepend=before_s)
        moves = dt > 0.0
        cut = steps.copy()
        if self.tick > 0.0 and track_m is not None:
            rims = []
            for i, travel in enumerate(rims_of(steps[:, 0], steps[:, 2], track_m)):
                one_m = np.where(moves, self.tick * dt, np.inf)
                so_far = np.cumsum(np.concatenate((phases[i : i + 1], travel / one_m)))
                rims.append(np.where(moves, np.diff(np.floor(so_far)) * self.tick * dt, travel))
                phases[i] = float(so_far[-1])
            cut[:, [0, 2]] = body_of(Rims(*rims), track_m)[:, [0, 2]]
        cut_to = np.trunc if self.rounding == "zero" else np.floor
        for column, size in ((0, self.step), (2, self.turn)):
            if size > 0.0:
                whole = size * dt
                counted = np.divide(cut[:, column], whole, out=np.zeros_like(dt), where=moves)
                cut[:, column] = np.where(moves, whole * cut_to(counted), cut[:, column])
        return Recorded(cut, (float(t_s[-1]), *phases) if len(t_s) else state)


def _mean_around(speed: Array, dt_s: Array) -> Array:
    """Return the mean (n,) of a speed in windows of `_NEAR_S` around the middle of each interval."""
    ends_s = np.concatenate(([0.0], np.cumsum(dt_s)))
    travel = np.concatenate(([0.0], np.cumsum(speed * dt_s)))
    middle_s = (ends_s[:-1] + ends_s[1:]) / 2.0
    first, last = (np.clip(middle_s + side * _NEAR_S / 2.0, 0.0, ends_s[-1]) for side in (-1.0, 1.0))
    return (np.interp(last, ends_s, travel) - np.interp(first, ends_s, travel)) / np.maximum(last - first, 1e-9)

"""Motor dead band: slow commands are not followed, under odometry computed from commanded velocities."""

from __future__ import annotations

from dataclasses import dataclass
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
)
from odomcorrupt.effects.wheels import (
    Rims,
    body_of,
    driven_speeds,
    error_of_each_wheel,
    on_every_track,
    rims_of,
    track_parameter,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array

_SPEEDS = (0.1, 0.25, 0.5)
"""Trial values of the band's upper end, as fractions of a drive's usual speed."""
_RISE = 1.25
"""With beyond = full: ratio of the speed from which commands are followed fully to the band's upper end."""


@dataclass(frozen=True, slots=True)
class DeadBand(Effect):
    """f_wheel = -loss u up to `speed`; beyond it -loss speed sign(u), or (beyond = full) soon zero.

    u is the commanded and reported rim speed. With loss = 1 the wheel stands still within the band, as a motor below
    the duty cycle that overcomes its friction. Without a track, the band applies to the body's speed.
    """

    name = "dead_band"
    odd = True
    layer = "record"
    summary = "wheels do not follow slow commands: the robot moves less than its odometry reports"
    about = About(
        equation="f_wheel = -loss u where abs(u) < speed; -loss speed sign(u) beyond (beyond = full: 0)",
        typical="a tenth to a third of full speed on geared hobby motors without speed control (an estimate)",
        source="Coulomb friction of DC motors; Olsson, Astrom, Canudas de Wit, Gafvert & Lischinsky 1998, "
        "European Journal of Control 4(3)",
        confused_with=("wheel_scale", "speed_scale", "truncated_velocity", "counts_lost"),
        drive="the same straight, and turns on the spot, at several speeds, the slowest that moves it among them",
    )

    loss: float = parameter("", "part of the speed that is lost within the band", low=0.0, high=1.25, typical=0.8)
    speed: float = parameter(
        "m/s", "rim speed at which the band ends", low=0.005, high=2.0, typical=0.05, identity=0.05, amplitude=False
    )
    beyond: str = choice("what is lost beyond the band: as much as at its end, or nothing", "less", "full")
    track: float = track_parameter()

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:
        """Return a candidate for each trial end of the band and, on a known track, for either loss beyond it.

        The two gain at other speeds. On a track that is only tried, the sharp end of a band fits any event of a slow
        wheel: a lawn mower got noise four times too large beside it.
        """
        moving = driven_speeds(motions)
        if not len(moving):
            return ()
        usual = float(np.quantile(moving, 0.9))
        ends = [float(np.clip(part * usual, 0.005, 2.0)) for part in _SPEEDS]
        losses = ("less",) if motions[0].track_m is None else ("less", "full")
        return on_every_track([cls(speed=end, beyond=beyond) for beyond in losses for end in ends], motions)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: minus the speed lost at the commanded speed."""
        return TwistError(error_of_each_wheel(lambda u: -self._lost(u), motion, self.track or motion.track_m), state)

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:
        """Return the increments that must be commanded to obtain these."""
        last_s = float(t_s[-1]) if len(t_s) else state
        dt = np.diff(t_s, prepend=0.0 if state is None else state)
        if self.loss == 0.0 or not len(steps):
            return Recorded(steps, last_s)
        rate = np.divide(1.0, dt, out=np.zeros_like(dt), where=dt > 0.0)
        track_m = self.track or track_m
        if track_m is None:
            v = steps[:, 0] * rate
            more = np.divide(self._commanded(v), v, out=np.ones_like(v), where=v != 0.0)
            return Recorded(steps * np.stack((more, np.ones_like(v), more), axis=1), last_s)
        rims = rims_of(steps[:, 0] * rate, steps[:, 2] * rate, track_m)
        more_of_each = Rims(*((self._commanded(u) - u) * dt for u in rims))
        return Recorded(steps + body_of(more_of_each, track_m), last_s)

    def _lost(self, u: Array) -> Array:
        """Return the lost speed (n,) at commanded speeds."""
        fast = np.abs(u)
        lost = np.minimum(fast, self.speed)
        if self.beyond == "full":
            lost = lost * np.clip((_RISE * self.speed - fast) / ((_RISE - 1.0) * self.speed), 0.0, 1.0)
        return self.loss * np.sign(u) * lost

    def _commanded(self, u: Array) -> Array:
        """Return the commanded speeds (n,) for these wheel speeds, linear between the corners."""
        at = np.array([0.0, self.speed, _RISE * self.speed, 1e3])
        reached = at - self._lost(at)
        reached = np.maximum.accumulate(reached + 1e-15 * np.arange(len(at)))
        return np.sign(u) * np.where(u == 0.0, 0.0, np.interp(np.abs(u), reached, at))

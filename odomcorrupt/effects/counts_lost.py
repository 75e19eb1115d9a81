"""Encoder counts lost above a rim speed, because the counter is too slow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter
from odomcorrupt.effects.wheels import (
    driven_speeds,
    error_of_each_wheel,
    on_every_track,
    track_parameter,
)

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array

_SPEEDS = (0.4, 0.6, 0.75, 0.88)
"""Trial values of the speed limit, as fractions of a drive's highest rim speed."""


@dataclass(frozen=True, slots=True)
class CountsLost(Effect):
    """f of a wheel = part (abs(u) - speed) sign(u) where the reported rim speed u is above `speed`.

    Beyond that speed, 1 / (1 + part) of a wheel's rotation is counted. Without a track, f applies to the body.
    """

    name = "counts_lost"
    odd = True
    summary = "encoder counts are lost above a speed: fast wheels go farther than is counted"
    about = About(
        equation="f_wheel = part (abs(u) - speed) sign(u) where abs(u) > speed",
        typical="from half of full speed on where interrupts of a microcontroller count a fast encoder (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("speed_scale", "wheel_scale", "dead_band"),
        drive="the same straight at several speeds up to the highest, and fast turns on the spot",
    )

    part: float = parameter(
        "", "travel lost above the speed, over travel counted there", low=0.0, high=20.0, typical=0.3
    )
    speed: float = parameter(
        "m/s",
        "rim speed above which they are lost",
        low=0.02,
        high=10.0,
        typical=0.3,
        identity=0.3,
        amplitude=False,
    )
    track: float = track_parameter()

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:
        """Return a candidate for each trial speed limit."""
        moving = driven_speeds(motions)
        if not len(moving):
            return ()
        most = float(np.quantile(moving, 0.99))
        limits = [cls(speed=float(np.clip(part * most, 0.02, 10.0))) for part in _SPEEDS]
        return on_every_track(limits, motions)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the speed that was not counted."""
        return TwistError(error_of_each_wheel(self._missed, motion, self.track or motion.track_m), state)

    def _missed(self, u: Array) -> Array:
        """Return the uncounted speed (n,) at reported speeds."""
        return self.part * np.sign(u) * np.maximum(np.abs(u) - self.speed, 0.0)

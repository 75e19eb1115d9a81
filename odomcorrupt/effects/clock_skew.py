"""Odometry clock that runs fast or slow."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array


@dataclass(frozen=True, slots=True)
class ClockSkew(Effect):
    """f = rate (t (a, ay, alpha) + (v, vy, omega)); in a bag, every odometry stamp moves by rate * t.

    f is a first-order equivalent for the regression only; the stamp shift is exact.
    """

    name = "clock_skew"
    odd = True
    kind = "setup"
    summary = "the odometry's clock runs fast or slow against the truth's"
    clock = True
    about = About(
        equation="f = rate (t (a, ay, alpha) + (v, vy, omega))",
        typical="1e-6 to 1e-4 between unsynchronised computers",
        source="engineering judgement; no published figures known to us",
        confused_with=("time_offset", "wheel_scale"),
        drive="more than five minutes with starts and stops throughout",
    )

    rate: float = parameter("", "odometry clock rate over true rate, minus one", low=-0.1, high=0.1, typical=1e-4)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f to first order: a time offset that grows, and speeds measured with a wrong unit of time."""
        twist = stacked(motion.v, motion.vy, motion.omega, motion.v)
        return TwistError(self.rate * (motion.t_s[:, None] * motion.acceleration + twist), state)

    def stamp_shift_s(self, t_s: Array) -> Array:
        """Return the stamp shift (n,), seconds, proportional to time."""
        return self.rate * t_s

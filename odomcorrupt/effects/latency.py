"""Odometry messages that are delayed before they are stamped, and then arrive in one burst."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked
from odomcorrupt.effects.event_window import time_parameter

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

_BURST = 1e-3
"""Duration of the burst as a fraction of the delay; above zero, so that stamps still ascend."""


@dataclass(frozen=True, slots=True)
class Latency(Effect):
    """In a bag, stamps between time and time + delay move to the end of that window, close behind each other.

    The poses are correct but stamped late: a localisation pairs them with later laser scans. f is the first-order
    equivalent for a regression.
    """

    name = "latency"
    kind = "event"
    summary = "once, odometry messages are delayed, and stamped when they arrive in a burst"
    clock = True
    about = About(
        equation="stamp = t + 0.999 (time + delay - t) where time <= t < time + delay; f = shift (a, ay, alpha) "
        "- 0.999 (v, vy, omega) there",
        typical="0.05 to 1 s over WiFi or a loaded computer (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("time_offset", "odometry_stop"),
        drive="none: it happens once; a pause in the stamps and then a burst show it",
    )

    delay: float = parameter("s", "how long messages are delayed", low=0.0, high=60.0, typical=0.5)
    time: float = time_parameter()

    @property
    def window_s(self) -> tuple[float, float]:
        """Begin and end of the event, seconds after the first odometry stamp."""
        return self.time, self.time + self.delay

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f to first order: a time offset that shrinks."""
        shift = self.stamp_shift_s(motion.t_s)
        twist = stacked(motion.v, motion.vy, motion.omega, motion.v)
        rate = np.where(shift > 0.0, _BURST - 1.0, 0.0)
        return TwistError(shift[:, None] * motion.acceleration + rate[:, None] * twist, state)

    def stamp_shift_s(self, t_s: Array) -> Array:
        """Return the delay of each stamp (n,), seconds."""
        begin, end = self.window_s
        return np.where((t_s >= begin) & (t_s < end), (1.0 - _BURST) * (end - t_s), 0.0)

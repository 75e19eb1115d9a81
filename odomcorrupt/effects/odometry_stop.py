"""Odometry that stops for a while although the robot drives on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, Recorded, State, TwistError, choice, parameter
from odomcorrupt.effects.event_window import time_parameter
from odomcorrupt.geometry.increments import Increments, accumulate, increments

if TYPE_CHECKING:
    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array


@dataclass(frozen=True, slots=True)
class OdometryStop(Effect):
    """Increments that end between time and time + duration are reported as zero.

    Their travel is then lost, as when a motor controller restarts, or added to the next increment, as when its bus was
    blocked while its encoders went on counting.
    """

    name = "odometry_stop"
    kind = "event"
    layer = "record"
    summary = "once, the odometry stands still for a while although the robot drives on"
    about = About(
        equation="reported increment = 0 where time < t <= time + duration; then lost, or added to the next one",
        typical="0.5 to 5 s while a motor controller or a bus recovers (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("lost_increments", "slip_event"),
        drive="none: it happens once; a pose that repeats while the truth moves shows it",
    )

    duration: float = parameter("s", "how long it stands still", low=0.0, high=1e4, typical=2.0)
    time: float = time_parameter()
    then: str = choice("what becomes of the travel that was not reported", "lost", "caught_up")

    @property
    def window_s(self) -> tuple[float, float]:
        """Begin and end of the event, seconds after the first odometry stamp."""
        return self.time, self.time + self.duration

    @property
    def lost_m(self) -> float:
        """Unbounded: travel that was never reported cannot be recovered."""
        return float("inf") if self.acts else 0.0

    def start(self, rng: Generator) -> State:  # noqa: ARG002 - nothing is drawn
        """Return the motion withheld so far: zero."""
        return np.zeros(3)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f = 0: the loss is not a function of the odometry's motion."""
        return TwistError(np.zeros((len(motion), 3)), state)

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002
        """Return the increments with those during the stop withheld."""
        begin, end = self.window_s
        inside = (t_s > begin) & (t_s <= end)
        after = np.flatnonzero(t_s > end)
        withheld = accumulate(state, _increments(steps[inside]))[-1]
        out = np.where(inside[:, None], 0.0, steps)
        if self.then == "caught_up" and len(after) and withheld.any():
            first = after[0]
            reached = accumulate(withheld, _increments(steps[first : first + 1]))[-1]
            whole = increments(np.stack((np.zeros(3), reached)))
            out[first] = whole.ds_m[0], whole.dl_m[0], whole.dtheta_rad[0]
            withheld = np.zeros(3)
        return Recorded(out, withheld)


def _increments(steps: Array) -> Increments:
    return Increments(steps[:, 0], steps[:, 1], steps[:, 2])

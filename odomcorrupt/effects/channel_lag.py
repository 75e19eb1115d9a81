"""The odometry's travel or turn follows the robot with a first-order lag: filters, servos, and any short delay."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, Recorded, State, TwistError, choice, parameter, stacked
from odomcorrupt.geometry.motion import TRAIL_S, accelerations

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

_COLUMN = {"along": 0, "yaw": 2}


@dataclass(frozen=True, slots=True)
class ChannelLag(Effect):
    """f_yaw = tau d omega / dt, or f_along = tau d v / dt, of the odometry's own speeds: the true ones, filtered.

    A delay of one channel by tau is the same for motion that is slow against it. A lag of both is a late clock as well.
    In corruption the channel passes through the filter itself, which is stable whatever tau is.
    """

    name = "channel_lag"
    odd = True
    layer = "record"
    summary = "the odometry's turns, or its travel, come late: a filter, a servo, a delay of one channel"
    about = About(
        equation="f = tau d omega' / dt of the yaw rate omega' that odometry reports, or tau d v' / dt of its speed",
        typical="10 to 100 ms by low-pass filters, 50 to 300 ms by steering servos (an estimate)",
        source="first-order low-pass filter; Franklin, Powell & Emami-Naeini, Feedback Control of Dynamic Systems",
        confused_with=("time_offset", "accel_slip", "backlash"),
        drive="speed up and brake on straights, and turn on the spot briskly: a late clock delays both alike",
    )

    tau: float = parameter("s", "time constant of the filter, or the delay", low=0.0, high=1.0, typical=0.05)
    channel: str = choice("what comes late", "yaw", "along")

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the lag of the filter, from the accelerations of the reported motion."""
        twist = np.stack((motion.v, motion.vy, motion.omega), axis=1)
        faster = accelerations(twist, motion.dt_s, state)
        f = self.tau * faster.rate[:, _COLUMN[self.channel]]
        along, yaw = (0.0, f) if self.channel == "yaw" else (f, 0.0)
        return TwistError(stacked(along, 0.0, yaw, f), faster.memory)

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002
        """Return the increments (n, 3) with one channel filtered: inverted by `twist_error`."""
        if self.tau == 0.0:
            return Recorded(steps, state)
        column = _COLUMN[self.channel]
        filtered, way = steps.copy(), _FilterState() if state is None else copy.deepcopy(state)
        for i, (step, now_s) in enumerate(zip(steps[:, column].tolist(), t_s.tolist(), strict=True)):
            filtered[i, column] = way.reported(step, now_s, self.tau)
        return Recorded(filtered, way)


class _FilterState:
    """The last `TRAIL_S` of what a filtered channel reported, m or rad over seconds, and its mean speed over them."""

    def __init__(self) -> None:
        self.clock_s: list[float] = []
        self.gone: list[float] = []
        self.speed = self.last_s = 0.0

    def reported(self, step: float, now_s: float, tau_s: float) -> float:
        """Return what is reported of a step that ends then: r with r + tau (change of the mean speed) = step."""
        if now_s < self.last_s:  # time was reset
            self.clock_s, self.gone = [], []
            self.last_s = 0.0
        dt_s, self.last_s = now_s - self.last_s, now_s
        if not dt_s > 0.0:
            return step
        if not self.clock_s:  # before the first interval the robot moved as in it
            before, self.speed = 2.0 * TRAIL_S, step / dt_s
            self.clock_s, self.gone = [-before, 0.0], [-before * self.speed, 0.0]
        now = self.clock_s[-1] + dt_s
        if dt_s < TRAIL_S:
            since = self.gone[-1] - float(np.interp(now - TRAIL_S, self.clock_s, self.gone))
            step = (step + tau_s * (self.speed - since / TRAIL_S)) / (1.0 + tau_s / TRAIL_S)
            self.speed = (step + since) / TRAIL_S
        else:
            step = (step + tau_s * self.speed) / (1.0 + tau_s / dt_s)
            self.speed = step / dt_s
        self.clock_s.append(now)
        self.gone.append(self.gone[-1] + step)
        while len(self.clock_s) > 2 and self.clock_s[1] < now - TRAIL_S:
            del self.clock_s[0], self.gone[0]
        return step

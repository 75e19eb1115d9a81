"""The odometry's travel or turn comes late: by the first-order lag of a filter or a servo, or by a pure delay."""

from __future__ import annotations

import copy
from bisect import bisect_right
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, Recorded, State, TwistError, choice, parameter, stacked
from odomcorrupt.geometry.motion import TRAIL_S, accelerations

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

_COLUMN = {"along": 0, "yaw": 2}
_SPEED = {"along": "v", "yaw": "omega"}
_UNSEEN = 10.0
"""Change of speed that a delay may hide before a recording ends, m/s^2 and rad/s^2."""


@dataclass(frozen=True, slots=True)
class ChannelLag(Effect):
    """f_yaw = tau d omega / dt, or f_along = tau d v / dt, of the odometry's own speeds: the true ones, filtered.

    A delay of one channel by tau is the same to first order, for motion that is slow against it; exactly, the true
    speed at a time is the one that odometry reports tau later. A lag of both channels is a late clock as well. In
    corruption the channel passes through the filter or the delay itself, which is stable whatever tau is.
    """

    name = "channel_lag"
    odd = True
    layer = "record"
    summary = "the odometry's turns, or its travel, come late: a filter, a servo, a delay of one channel"
    about = About(
        equation="f = tau d omega' / dt of the yaw rate omega' that odometry reports, or tau d v' / dt of its speed; "
        "a delay: f = omega'(t + tau) - omega'(t)",
        typical="10 to 100 ms by low-pass filters, 50 to 300 ms by steering servos, 20 to 150 ms by a gyro's driver "
        "(an estimate)",
        source="first-order low-pass filter; Franklin, Powell & Emami-Naeini, Feedback Control of Dynamic Systems",
        confused_with=("time_offset", "accel_slip", "backlash"),
        drive="speed up and brake on straights, and turn on the spot briskly: a late clock delays both alike",
    )

    tau: float = parameter("s", "time constant of the filter, or the delay", low=0.0, high=1.0, typical=0.05)
    channel: str = choice("what comes late", "yaw", "along")
    by: str = choice("what makes it late", "filter", "delay")

    @property
    def lost_m(self) -> float:
        """A recording ends before what a delay holds back, and between two stamps a speed changes unseen."""
        return _UNSEEN * self.tau**2 if self.by == "delay" else 0.0

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the lag of the filter, from the accelerations of the reported motion; of a delay to first order."""
        if self.by == "delay":
            later = self.tau * motion.acceleration[:, _COLUMN[self.channel]]
            return TwistError(stacked(*self._either(later), later), state)
        twist = np.stack((motion.v, motion.vy, motion.omega), axis=1)
        faster = accelerations(twist, motion.dt_s, state)
        f = self.tau * faster.rate[:, _COLUMN[self.channel]]
        return TwistError(stacked(*self._either(f), f), faster.memory)

    def _either(self, f: Array) -> tuple[Array | float, float, Array | float]:
        return (0.0, 0.0, f) if self.channel == "yaw" else (f, 0.0, 0.0)

    def restored(self, motion: Motion) -> Motion:
        """Return the motion that should have been reported: of a delay, what is reported tau later."""
        if self.by == "filter" or not len(motion):
            return super(ChannelLag, self).restored(motion)
        speed, dt_s = getattr(motion, _SPEED[self.channel]), motion.dt_s
        time_s = np.concatenate(([0.0], np.cumsum(dt_s)))
        gone = np.concatenate(([0.0], np.cumsum(speed * dt_s)))
        last = speed[dt_s > 0.0][-1] if (dt_s > 0.0).any() else 0.0  # it goes on as it was seen last
        beyond_s = max(self.tau, 0.0)
        till = np.interp(
            time_s + self.tau, np.append(time_s, time_s[-1] + beyond_s), np.append(gone, gone[-1] + beyond_s * last)
        )
        true = np.divide(np.diff(till), dt_s, out=speed.copy(), where=dt_s > 0.0)
        return replace(motion, **{_SPEED[self.channel]: true})

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002
        """Return the increments (n, 3) with one channel filtered or delayed: inverted by `restored`."""
        if self.tau == 0.0:
            return Recorded(steps, state)
        column, fresh = _COLUMN[self.channel], _FilterState if self.by == "filter" else _DelayState
        late, way = steps.copy(), fresh() if state is None else copy.deepcopy(state)
        for i, (step, now_s) in enumerate(zip(steps[:, column].tolist(), t_s.tolist(), strict=True)):
            late[i, column] = way.reported(step, now_s, self.tau)
        return Recorded(late, way)


class _LateState:
    """The way gone by one channel (m or rad) at times (s), as far as it is needed still."""

    def __init__(self) -> None:
        self.clock_s: list[float] = []
        self.gone: list[float] = []
        self.last_s = 0.0

    def elapsed_s(self, now_s: float) -> float:
        """Return the time since the step before; where time was reset, all is forgotten."""
        if now_s < self.last_s:
            self.clock_s, self.gone = [], []
            self.last_s = 0.0
        dt_s, self.last_s = now_s - self.last_s, now_s
        return dt_s


class _DelayState(_LateState):
    """What a delayed channel has not reported yet, and the stretch before it."""

    shown = 0.0

    def reported(self, step: float, now_s: float, tau_s: float) -> float:
        """Return what is reported over a step that ends then: what was done until tau before, and not yet reported."""
        dt_s = self.elapsed_s(now_s)
        if not dt_s > 0.0:
            return step
        if not self.clock_s:  # before the first interval the robot moved as in it
            self.shown = -tau_s * step / dt_s
            self.clock_s, self.gone = [-tau_s, 0.0], [self.shown, 0.0]
        self.clock_s.append(self.clock_s[-1] + dt_s)
        self.gone.append(self.gone[-1] + step)
        late_s = self.clock_s[-1] - tau_s
        i = min(max(bisect_right(self.clock_s, late_s), 1), len(self.clock_s) - 1)
        part = (late_s - self.clock_s[i - 1]) / (self.clock_s[i] - self.clock_s[i - 1])
        before, self.shown = self.shown, self.gone[i - 1] + part * (self.gone[i] - self.gone[i - 1])
        del self.clock_s[: i - 1], self.gone[: i - 1]
        return self.shown - before


class _FilterState(_LateState):
    """The last `TRAIL_S` of what a filtered channel reported, and its mean speed over them."""

    speed = 0.0

    def reported(self, step: float, now_s: float, tau_s: float) -> float:
        """Return what is reported of a step that ends then: r with r + tau (change of the mean speed) = step."""
        dt_s = self.elapsed_s(now_s)
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

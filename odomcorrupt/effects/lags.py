"""Delays and filters of the odometry's channels and motors."""

from __future__ import annotations

import copy
from bisect import bisect_right
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, Recorded, State, TwistError, choice, parameter

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array


_SPEEDS = ("v", "vy", "omega")
_COLUMNS = {"along": [0], "yaw": [2], "all": [0, 1, 2]}


def lag_remainder(tau_s: float, seconds: float) -> float:
    """Return the fraction of a difference that remains after a first-order lag has acted, by a backward Euler step.

    Its mean delay is tau for steps of any length, and its inverse is stable.
    """
    return abs(tau_s) / (abs(tau_s) + seconds) if seconds > 0.0 else 1.0


@dataclass(frozen=True, slots=True)
class ChannelLag(Effect):
    """f_yaw = tau d omega / dt, f_along = tau d v / dt, or all three; odometry reports low-pass filtered true speeds.

    A delay by tau has the same f to first order, for motion that changes little within tau; exactly, the true speed at
    time t is the speed that odometry reports at t + tau. A lag of all channels equals a late clock to first order.
    Corruption applies the filter or the delay itself, which is stable for any tau. The filter is updated once per
    message, and tau is its mean delay: half an interval less than the tau of a filter of weight exp(-dt / tau).
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
    channel: str = choice("what comes late", "yaw", "along", "all")
    by: str = choice("what makes it late", "filter", "delay")

    @property
    def lost_m(self) -> float:
        """Bound on the uncorrectable error, m: the last motion is never reported, nor are speeds between stamps."""
        # largest acceleration assumed during the delay at the end of a recording, m/s^2 and rad/s^2
        return 10.0 * self.tau**2 if self.by == "delay" else 0.0

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: for a filter from the accelerations of the reported motion, for a delay to first order."""
        if self.by == "delay":
            return TwistError(self._late(motion.acceleration), state)
        twist = motion.twist
        passes = motion.dt_s > 0.0
        rate = np.zeros_like(twist)
        if passes.any():
            shown = twist[passes]
            before = np.concatenate((shown[:1] if state is None else state[None], shown[:-1]))
            rate[passes] = (shown - before) / motion.dt_s[passes, None]
            state = shown[-1].copy()
        return TwistError(self._late(rate), state)

    def _late(self, rate: Array) -> Array:
        f = np.zeros_like(rate)
        late = _COLUMNS[self.channel]
        f[:, late] = self.tau * rate[:, late]
        return f

    def restored(self, motion: Motion) -> Motion:
        """Return the motion that should have been reported; for a delay the one that is reported tau later."""
        if not (motion.dt_s > 0.0).any():
            return motion
        names = [_SPEEDS[column] for column in _COLUMNS[self.channel]]
        earlier = self._unfiltered if self.by == "filter" else self._earlier
        true: dict[str, Any] = {name: earlier(getattr(motion, name), motion.dt_s) for name in names}
        return replace(motion, **true)

    def _unfiltered(self, speed: Array, dt_s: Array) -> Array:
        """Return the mean speeds (n,) in n intervals of length dt_s (n,) that a filter has turned into these.

        The output of a filter is smooth: if the increments are, and speeds show the jitter of stamps, the filter acted
        on increments at an even rate.
        """
        passes = dt_s > 0.0
        shown, dt_s = speed[passes], dt_s[passes]
        even = shown * dt_s / np.median(dt_s)
        rough = [np.abs(np.diff(u, n=2)).sum() for u in (shown, even)]
        # roughness of increments over that of speeds, below which a filter acted on increments
        filtered = even if rough[1] < 0.5 * rough[0] else shown
        true = speed.copy()
        true[passes] += self.tau * np.diff(filtered, prepend=filtered[0]) / dt_s
        return true

    def _earlier(self, speed: Array, dt_s: Array) -> Array:
        """Return the true mean speeds (n,) in n intervals of length dt_s (n,), from speeds reported tau later."""
        time_s = np.concatenate(([0.0], np.cumsum(dt_s)))
        path = np.concatenate(([0.0], np.cumsum(speed * dt_s)))
        last = speed[dt_s > 0.0][-1]  # extrapolated
        beyond_s = max(self.tau, 0.0)
        shifted = np.interp(
            time_s + self.tau, np.append(time_s, time_s[-1] + beyond_s), np.append(path, path[-1] + beyond_s * last)
        )
        return np.divide(np.diff(shifted), dt_s, out=speed.copy(), where=dt_s > 0.0)

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002
        """Return the increments (n, 3) with late channels filtered or delayed; the inverse is `restored`."""
        if self.tau == 0.0:
            return Recorded(steps, state)
        columns, new_state = _COLUMNS[self.channel], _FilterState if self.by == "filter" else _DelayState
        late, past = steps.copy(), [new_state() for _ in columns] if state is None else copy.deepcopy(state)
        for column, channel in zip(columns, past, strict=True):
            for i, (step, now_s) in enumerate(zip(steps[:, column].tolist(), t_s.tolist(), strict=True)):
                late[i, column] = channel.reported(step, now_s, self.tau)
        return Recorded(late, past)


class _FilterState:
    """State of a filtered channel: its last reported speed, None at the beginning, and the time of the last step."""

    def __init__(self) -> None:
        self.speed: float | None = None
        self.last_s = 0.0

    def reported(self, step: float, now_s: float, tau_s: float) -> float:
        """Return the increment reported at `now_s`."""
        dt_s, self.last_s = now_s - self.last_s, now_s
        if not dt_s > 0.0:
            self.speed = self.speed if dt_s == 0.0 else None  # a reset of time clears the history
            return step
        true = step / dt_s
        self.speed = true if self.speed is None else true + lag_remainder(tau_s, dt_s) * (self.speed - true)
        return self.speed * dt_s


class _DelayState:
    """State of a delayed channel: motion (m or rad) at times (s) that is not reported yet, and what was reported."""

    def __init__(self) -> None:
        self.clock_s: list[float] = []
        self.path: list[float] = []
        self.output = self.last_s = 0.0

    def reported(self, step: float, now_s: float, tau_s: float) -> float:
        """Return the increment reported at `now_s`: the motion until `tau_s` earlier that was not reported before."""
        dt_s, self.last_s = now_s - self.last_s, now_s
        if not dt_s > 0.0:
            if dt_s < 0.0:  # a reset of time clears the history
                self.clock_s, self.path = [], []
            return step
        if not self.clock_s:  # extrapolate the first interval backwards
            self.output = -tau_s * step / dt_s
            self.clock_s, self.path = [-tau_s, 0.0], [self.output, 0.0]
        self.clock_s.append(self.clock_s[-1] + dt_s)
        self.path.append(self.path[-1] + step)
        late_s = self.clock_s[-1] - tau_s
        i = min(max(bisect_right(self.clock_s, late_s), 1), len(self.clock_s) - 1)
        part = (late_s - self.clock_s[i - 1]) / (self.clock_s[i] - self.clock_s[i - 1])
        before, self.output = self.output, self.path[i - 1] + part * (self.path[i] - self.path[i - 1])
        del self.clock_s[: i - 1], self.path[: i - 1]
        return self.output - before


_SUBSTEPS = 4
"""Backward Euler steps in one interval between messages, during which the command is held.

Their mean delay is tau for any number of them. The time constant of the decay is longer by half a substep, which a
clock offset beside the lag would absorb; more substeps amplify noise more in the inverse (twice tau / dt for one, four
times as much for four)."""


@dataclass(frozen=True, slots=True)
class MotorLag(Effect):
    """f = true twist - u, tau d(true twist)/dt + true twist = u: all speeds lag behind the odometry's.

    A clock that is ahead by tau does the same to first order. The odometry is that of commands; wheel encoders do not
    show a lag of the motors.
    """

    name = "motor_lag"
    layer = "record"
    initial = None, 0.0  # true speeds (3,) at the end of the last increment, m/s and rad/s, None at first; its time, s
    summary = "the robot follows late the velocity commands that its odometry integrates"
    about = About(
        equation="f = w - u, tau dw / dt + w = u: the true twist w follows the odometry's twist u",
        typical="50 to 400 ms for motors without speed control (an estimate)",
        source="first-order lag of a DC motor with its load; Siciliano, Sciavicco, Villani & Oriolo, Robotics, "
        "section 5.2",
        confused_with=("time_offset", "channel_lag", "accel_slip"),
        drive="speed up and brake briskly, straight and turning; record both on one clock",
    )

    tau: float = parameter("s", "time constant", low=0.0, high=1.0, typical=0.1, step=0.2)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f, the true speeds minus the commanded ones; for tau < 0, needed for slopes, the opposite."""
        if not len(motion):
            return TwistError(np.zeros((0, 3)), state)
        commanded = np.stack((motion.v, motion.vy, motion.omega))
        mean, last = _kept(abs(self.tau), motion.dt_s)
        kept = last.tolist()
        start = commanded[:, 0] if state[0] is None else state[0]
        before = np.zeros((3, len(motion) + 1))
        for i in np.flatnonzero(commanded.any(axis=1) | (start != 0.0)):
            before[i] = _followed(commanded[i].tolist(), kept, float(start[i]))
        change = mean * (before[:, :-1] - commanded)
        return TwistError(np.sign(self.tau) * change.T, (before[:, -1], state[1]))

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - no wheels
        """Return the commanded increments (n, 3) that move the robot by these."""
        reported = steps.copy()
        before, last_s = state
        dt_s = np.diff(t_s, prepend=last_s)
        kept = np.stack(_kept(abs(self.tau), dt_s), axis=1).tolist()
        for i, (step, seconds, (mean, last)) in enumerate(zip(steps, dt_s.tolist(), kept, strict=True)):
            if not seconds > 0.0:  # repeated stamp, or a reset of time
                before = before if seconds == 0.0 else None
                continue
            commanded = step / seconds
            if before is None:
                before = commanded
                continue
            commanded = (commanded - mean * before) / (1.0 - mean)
            reported[i] = seconds * commanded
            before = commanded + last * (before - commanded)
        last_s = float(t_s[-1]) if len(t_s) else last_s
        return Recorded(reported, (before, last_s))


def _kept(tau_s: float, dt_s: Array) -> tuple[Array, Array]:
    """Return how much of a difference between speed and command is left in intervals: their means (n,) and ends (n,).

    All of it in an interval of no duration.
    """
    total = tau_s + np.maximum(dt_s, 0.0) / _SUBSTEPS
    one = np.divide(tau_s, total, out=np.ones_like(dt_s), where=dt_s > 0.0)
    left = one ** np.arange(1, _SUBSTEPS + 1)[:, None]
    return left.mean(axis=0), left[-1]


def _followed(commanded: list[float], kept: list[float], now: float) -> list[float]:
    """Return the true speed at the start of each interval and at the end, from the fraction kept in each by a lag."""
    return [now, *(now := u + k * (now - u) for u, k in zip(commanded, kept, strict=True))]

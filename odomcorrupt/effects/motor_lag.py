"""Lag of the motors behind the velocity commands that the odometry integrates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, Recorded, State, TwistError, parameter

if TYPE_CHECKING:
    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array


_SUBSTEPS = 4
"""Backward Euler steps in one interval between messages, during which the command is held.

Their mean delay is tau for any number of them. The time constant of the decay is longer by half a substep, which a
clock offset beside the lag would absorb; more substeps amplify noise more in the inverse (twice tau / dt for one, four
times as much for four)."""


class _Speeds(NamedTuple):
    """State: true speeds (3,) at the end of the last increment, m/s and rad/s (None at the start), and that time, s."""

    twist: Array | None = None
    last_s: float = 0.0


@dataclass(frozen=True, slots=True)
class MotorLag(Effect):
    """f = true twist - u, tau d(true twist)/dt + true twist = u: all speeds lag behind the odometry's.

    A clock that is ahead by tau does the same to first order. The odometry is that of commands; wheel encoders do not
    show a lag of the motors.
    """

    name = "motor_lag"
    layer = "record"
    in_place_of = "time_offset"
    summary = "the robot follows late the velocity commands that its odometry integrates"
    about = About(
        equation="f = w - u, tau dw / dt + w = u: the true twist w follows the odometry's twist u",
        typical="50 to 400 ms for motors without speed control (an estimate)",
        source="first-order lag of a DC motor with its load; Siciliano, Sciavicco, Villani & Oriolo, Robotics, "
        "section 5.2",
        confused_with=("time_offset", "channel_lag", "accel_slip"),
        drive="speed up and brake briskly, straight and turning; record both on one clock",
    )

    tau: float = parameter("s", "time constant", low=0.0, high=1.0, typical=0.1, step=0.02)

    def start(self, rng: Generator) -> State:  # noqa: ARG002 - nothing is drawn
        """Return the state of a robot whose first speeds are the commanded ones."""
        return _Speeds()

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f, the true speeds minus the commanded ones; for tau < 0, needed for slopes, the opposite."""
        if not len(motion):
            return TwistError(np.zeros((0, 3)), state)
        commanded = np.stack((motion.v, motion.vy, motion.omega))
        mean, last = _kept(abs(self.tau), motion.dt_s)
        kept = last.tolist()
        start = commanded[:, 0] if state.twist is None else state.twist
        before = np.zeros((3, len(motion) + 1))
        for i in np.flatnonzero(commanded.any(axis=1) | (start != 0.0)):
            before[i] = _followed(commanded[i].tolist(), kept, float(start[i]))
        change = mean * (before[:, :-1] - commanded)
        return TwistError(np.sign(self.tau) * change.T, state._replace(twist=before[:, -1]))

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
        return Recorded(reported, _Speeds(before, last_s))


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

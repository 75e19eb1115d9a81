"""Complementary filter that takes slow turns from wheels with a wrong gain, and fast turns from a gyro."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple, Self

from odomcorrupt.drive_types import PIVOTING
from odomcorrupt.effects.effect import About, Effect, Motion, Recorded, State, TwistError, parameter, stacked
from odomcorrupt.effects.random_state import autoregression

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array

_TIMES_S = (1.0, 3.0, 10.0, 30.0)
"""Trial time constants, seconds: at 1 s nearly all turns come from the wheels, at 30 s nearly all from the gyro."""


class _Filtered(NamedTuple):
    """State: the low-pass filtered yaw rate of the odometry, rad/s, and the last stamp, seconds."""

    rate: float = 0.0
    last_s: float = 0.0


@dataclass(frozen=True, slots=True)
class ComplementaryFilter(Effect):
    """f = (0, 0, -e / (1 + e) L omega), L a low-pass filter of time constant tau / (1 + e).

    The reported heading follows the gyro at once, and the wheels' heading with time constant tau. Turns of the wheels'
    heading are (1 + e) times the true ones. The heading error d obeys tau d' + d = error of the wheels' heading.
    """

    name = "complementary_filter"
    layer = "record"
    summary = "a filter blends a gyro with a wheel heading of wrong gain: the error of a turn appears seconds later"
    needs_gyro = True
    drives = PIVOTING
    about = About(
        equation="f_yaw = -e / (1 + e) L omega, L a low-pass filter of time constant tau / (1 + e)",
        typical="e as in wheelbase, 0.5 to 5 %; tau 1 to 30 s (a shorter one is a lag of the wheels' heading)",
        source="Mahony, Hamel & Pflimlin 2008, IEEE T-AC 53(5), with one axis",
        confused_with=("wheelbase", "gyro_bias_walk", "channel_lag"),
        drive="turn by 180 deg on the spot, and stand still for a minute: the heading creeps at rest",
    )

    e: float = parameter("", "turn of the wheels divided by the true one, minus one", low=-0.5, high=1.0, typical=0.015)
    tau: float = parameter(
        "s", "time constant of the filter", low=1.0, high=100.0, typical=3.0, identity=3.0, amplitude=False
    )

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:  # noqa: ARG003 - filters do not depend on the drive
        """Return a candidate for each trial time constant."""
        return tuple(replace(cls(), tau=tau) for tau in _TIMES_S)

    def start(self, rng: Generator) -> State:  # noqa: ARG002 - nothing is drawn
        """Return the state of a robot that has not turned for a long time."""
        return _Filtered()

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f, from the filtered yaw rate (a backward Euler step for each interval)."""
        kept = self._time_s / (self._time_s + motion.dt_s)
        slow = autoregression(state.rate, kept, (1.0 - kept) * motion.omega)
        last = float(slow[-1]) if len(slow) else state.rate
        return TwistError(stacked(0.0, 0.0, -self._gain * slow, motion.v), state._replace(rate=last))

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - no wheels
        """Return the increments (n, 3) with the turns that the filter reports; the inverse is `restored`."""
        reported = steps.copy()
        slow, last_s = state
        for i, (turn, now_s) in enumerate(zip(steps[:, 2].tolist(), t_s.tolist(), strict=True)):
            dt_s, last_s = now_s - last_s, now_s
            if not dt_s > 0.0:  # repeated stamp, or a reset of time
                slow = slow if dt_s == 0.0 else 0.0
                continue
            kept = self._time_s / (self._time_s + dt_s)
            rate = (turn / dt_s + self._gain * kept * slow) / (1.0 - self._gain * (1.0 - kept))
            slow = kept * slow + (1.0 - kept) * rate
            reported[i, 2] = rate * dt_s if self.e else turn
        return Recorded(reported, _Filtered(slow, last_s))

    @property
    def _gain(self) -> float:
        return self.e / (1.0 + self.e)

    @property
    def _time_s(self) -> float:
        return self.tau / (1.0 + self.e)

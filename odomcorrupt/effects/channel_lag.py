"""The odometry's travel or turn follows the robot with a first-order lag: filters, servos, and any short delay."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from odomcorrupt.effects.effect import (
    About,
    Effect,
    Kind,
    Layer,
    Motion,
    Recorded,
    State,
    TwistError,
    choice,
    parameter,
    stacked,
)

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

_FIELDS = {"yaw": ("omega", 2), "along": ("v", 0)}
"""Of each channel the speed in a motion, and the column of an increment."""


@dataclass(frozen=True, slots=True)
class ChannelLag(Effect):
    """f_yaw = tau d omega / dt, or f_along = tau d v / dt, of the odometry's own speeds: the true ones, filtered.

    A delay of one channel by tau is the same for motion that is slow against it. A lag of both is a late clock as well.
    In corruption the channel passes through the filter itself, which is stable whatever tau is.
    """

    name: ClassVar[str] = "channel_lag"
    kind: ClassVar[Kind] = "effect"
    layer: ClassVar[Layer] = "record"
    summary: ClassVar[str] = "the odometry's turns, or its travel, come late: a filter, a servo, a delay of one channel"
    about: ClassVar[About | None] = About(
        equation="f = tau d omega' / dt of the yaw rate omega' that odometry reports, or tau d v' / dt of its speed",
        typical="10 to 100 ms by low-pass filters, 50 to 300 ms by steering servos (an estimate)",
        source="first-order low-pass filter; Franklin, Powell & Emami-Naeini, Feedback Control of Dynamic Systems",
        confused_with=("time_offset", "accel_slip", "backlash"),
        drive="speed up and brake on straights, and turn on the spot briskly: a late clock delays both alike",
    )

    tau: float = parameter("s", "time constant of the filter, or the delay", low=0.0, high=1.0, typical=0.05)
    channel: str = choice("what comes late", "yaw", "along")

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: what the filter still owes."""
        name, _ = _FIELDS[self.channel]
        speed, driven = getattr(motion, name), motion.dt_s > 0.0
        own = speed[driven]
        f = np.zeros(len(motion))
        if len(own):
            before = np.concatenate(([own[0] if state is None else state], own[:-1]))
            f[driven] = self.tau * (own - before) / motion.dt_s[driven]
            state = float(own[-1])
        along, yaw = (0.0, f) if self.channel == "yaw" else (f, 0.0)
        return TwistError(stacked(along, 0.0, yaw, f), state)

    def recorded_over(self, steps: Array, dt_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002
        """Return the increments (n, 3) with one channel filtered."""
        _, column = _FIELDS[self.channel]
        filtered = steps.copy()
        for i, (step, dt) in enumerate(zip(steps[:, column].tolist(), dt_s.tolist(), strict=True)):
            if dt > 0.0:
                inertia = self.tau / dt
                state = step / dt if state is None else (step / dt + inertia * state) / (1.0 + inertia)
                filtered[i, column] = state * dt
        return Recorded(filtered, state)

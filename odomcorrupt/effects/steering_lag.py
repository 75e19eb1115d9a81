"""Lag of the steered wheels behind the steering angle of the odometry, by a servo or a soft linkage."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.drive_types import STEERED
from odomcorrupt.effects.channel_lag import lag_remainder
from odomcorrupt.effects.effect import About, Effect, Motion, Recorded, State, TwistError, parameter, stacked
from odomcorrupt.effects.steering import CREEP_MPS

if TYPE_CHECKING:
    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array


class _Steering(NamedTuple):
    """State: curvature of the wheels when they last rolled (1/m, None before), time since then and last stamp (s)."""

    curvature: float | None = None
    ago_s: float = 0.0
    last_s: float = 0.0


@dataclass(frozen=True, slots=True)
class SteeringLag(Effect):
    """f = (0, 0, v (true curvature - omega / v)): the true curvature follows the odometry's with a first-order lag.

    A delay by tau has the same f for steering slow against tau. A change of speed in a curve of constant radius is no
    steering and causes no error. While the robot is at rest its wheels continue to the steering angle.
    """

    name = "steering_lag"
    layer = "record"
    summary = "a car's or tricycle's wheels follow the steering angle of its odometry late"
    drives = STEERED
    about = About(
        equation="f_yaw = v k - omega, tau dk / dt + k = omega / v: the true curvature k lags behind the odometry's",
        typical="50 to 300 ms by a steering servo whose command is taken for its angle (an estimate)",
        source="first-order lag; Rajamani, Vehicle Dynamics and Control, chapter 2 (kinematic bicycle model)",
        confused_with=("channel_lag", "time_offset", "accel_slip"),
        drive="steer briskly to both sides at a constant speed, and speed up and brake on straights and in curves",
    )

    tau: float = parameter("s", "time constant, or the delay", low=0.0, high=1.0, typical=0.1, step=0.02)

    def start(self, rng: Generator) -> State:  # noqa: ARG002 - nothing is drawn
        """Return the state of wheels that have not rolled yet."""
        return _Steering()

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f, from the lag of the wheels' curvature; for tau < 0, needed for slopes, the opposite."""
        f, sign = np.zeros(len(motion)), float(np.sign(self.tau))
        curvature, ago_s, last_s = state
        rows = zip(motion.v.tolist(), motion.omega.tolist(), motion.dt_s.tolist(), strict=True)
        for i, (v, omega, dt_s) in enumerate(rows):
            ago_s += dt_s
            if abs(v) < CREEP_MPS or not dt_s > 0.0:
                continue
            steered = omega / v
            curvature = (
                steered if curvature is None else steered + lag_remainder(self.tau, ago_s) * (curvature - steered)
            )
            f[i], ago_s = sign * v * (curvature - steered), 0.0
        return TwistError(stacked(0.0, 0.0, f, f), _Steering(curvature, ago_s, last_s))

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - no wheels
        """Return the increments (n, 3) computed from the steering angle whose lagging wheels cause these."""
        reported = steps.copy()
        curvature, ago_s, last_s = state
        for i, (ds, turn, now_s) in enumerate(
            zip(steps[:, 0].tolist(), steps[:, 2].tolist(), t_s.tolist(), strict=True)
        ):
            dt_s, last_s = now_s - last_s, now_s
            if dt_s < 0.0:  # time was reset
                curvature, ago_s = None, 0.0
                continue
            ago_s += dt_s
            if abs(ds) < CREEP_MPS * dt_s or not dt_s > 0.0:
                continue
            true = turn / ds
            kept = lag_remainder(self.tau, ago_s)
            if curvature is not None and self.tau > 0.0:
                reported[i, 2] = ds * (true - kept * curvature) / (1.0 - kept)
            curvature, ago_s = true, 0.0
        return Recorded(reported, _Steering(curvature, ago_s, last_s))

"""Driving plans: speeds over time for a manoeuvre, and the recording of an ideal robot on it."""

from __future__ import annotations

import io
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import write_twists
from odomcorrupt.geometry.se2 import Increments, accumulate, wrap
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.study.design.manoeuvres import Hold, Limits, straight, turn
from odomcorrupt.study.io.recording import Recording

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.design.manoeuvres import Manoeuvre

STEP_S = 0.05
"""Period of the commands, seconds."""
_FAST = (0.3, 1.2)  # range of the speed limit, m/s
_TURNING = (0.5, 1.2)  # range of the turn rate limit, rad/s
_REST_S = 2.0
_STOP = Hold(0.0, 0.0, 0.5)
_NEAR_M = 0.3  # distance from the start at which no return is needed
_STRAIGHT_RAD = 0.5
"""Smaller turns are left out, because they are too short for the ramps."""


@dataclass(frozen=True, slots=True)
class Plan:
    """Commands with period `STEP_S`, beginning and ending at rest.

    v_mps, omega_radps : (n,)
    """

    manoeuvre: Manoeuvre
    v_mps: Array
    omega_radps: Array

    @property
    def duration_s(self) -> float:
        """Duration, seconds."""
        return len(self.v_mps) * STEP_S

    @property
    def path(self) -> Array:
        """Poses (n + 1, 3) of a robot that follows the commands exactly from the origin, m and rad."""
        return _followed(self.v_mps, self.omega_radps)

    @property
    def floor_m(self) -> tuple[float, float]:
        """Length and width of the floor covered by the path, metres, the longer first."""
        size = np.ptp(self.path[:, :2], axis=0)
        return float(size.max()), float(size.min())

    @property
    def fastest_mps(self) -> float:
        """Largest speed, m/s."""
        return float(np.abs(self.v_mps).max())


def _followed(v_mps: Array, omega_radps: Array, start: Array | None = None) -> Array:
    steps = Increments(v_mps * STEP_S, np.zeros_like(v_mps), omega_radps * STEP_S)
    return accumulate(np.zeros(3) if start is None else start, steps)


def safe_limits(motions: Sequence[Motion]) -> Limits:
    """Return speed limits for a robot: its observed 98 % quantiles, clipped to a range that is harmless indoors."""
    v = np.concatenate([np.abs(m.v) for m in motions])
    omega = np.concatenate([np.abs(m.omega) for m in motions])
    seen = float(np.quantile(v, 0.98)), float(np.quantile(omega, 0.98))
    return Limits(float(np.clip(seen[0], *_FAST)), float(np.clip(seen[1], *_TURNING)))


def plan_of(manoeuvre: Manoeuvre, limits: Limits, duration_s: float) -> Plan:
    """Return the commands of whole moves for at least `duration_s` and the manoeuvre's own least duration."""
    rest = np.zeros((round(_REST_S / STEP_S), 2))
    speeds, now = [rest], np.zeros(2)
    left = round(max(duration_s, manoeuvre.least_s) / STEP_S)
    for step in manoeuvre.round(limits):
        holds = [step] if isinstance(step, Hold) else _homewards(np.concatenate([*speeds, _ramp(now, _STOP)]), limits)
        for hold in holds if isinstance(step, Hold) else [_STOP, *holds]:
            speeds.append(_ramp(now, hold))
            now = np.array(hold[:2])
            left -= len(speeds[-1])
        if left <= 0:
            break
    v, omega = np.concatenate([*speeds, _ramp(now, _STOP), rest]).T
    return Plan(manoeuvre, np.ascontiguousarray(v), np.ascontiguousarray(omega))


def _ramp(now: Array, hold: Hold) -> Array:
    """Return the commands (n, 2) of a ramp to given speeds and of the time at these speeds."""
    wanted = np.array(hold[:2])
    count = max(1, int(np.ceil(np.max(np.abs(wanted - now) / hold.accelerations) / STEP_S)))
    part = np.concatenate((np.arange(1, count + 1) / count, np.ones(round(hold.hold_s / STEP_S))))
    return now + part[:, None] * (wanted - now)


def _homewards(speeds: Array, limits: Limits) -> list[Hold]:
    """Return the moves at rest from the end of commands (n, 2) back to their start, with the initial heading."""
    x, y, theta = _followed(*speeds.T)[-1]
    away = float(np.hypot(x, y))
    if away < _NEAR_M:
        return []
    back = float(np.arctan2(-y, -x))
    moves = [*_turned(back - theta, limits), *straight(away, min(limits.v_mps, max(0.25 * away, 0.1)))]
    return [*moves, *_turned(-back, limits)]


def _turned(angle_rad: float, limits: Limits) -> list[Hold]:
    wrapped = float(wrap(np.array([angle_rad]))[0])
    return list(turn(wrapped, limits.omega_radps)) if abs(wrapped) > _STRAIGHT_RAD else []


def ideal_recording(plan: Plan, like: Recording) -> Recording:
    """Return the recording of an ideal robot and an ideal tracker, starting at the first pose of `like`."""
    stamps_ns = like.origin_ns + (np.arange(len(plan.v_mps) + 1) * round(STEP_S * 1e9)).astype(np.int64)
    odometry = Trajectory(stamps_ns, plan.path)
    truth = Trajectory(stamps_ns, _followed(plan.v_mps, plan.omega_radps, np.nan_to_num(like.truth.xyt[0])))
    return Recording(plan.manoeuvre.name, odometry, truth, like.origin_ns, like.track_m)


def drive_bag(plan: Plan) -> bytes:
    """Return an MCAP whose /cmd_vel executes a plan."""
    twist = np.stack((plan.v_mps, np.zeros_like(plan.v_mps), plan.omega_radps), axis=1)
    bag = io.BytesIO()
    write_twists(bag, np.arange(len(twist), dtype=np.float64) * STEP_S, twist)
    return bag.getvalue()

"""A manoeuvre as it would be driven: speeds over time, and the recording that a perfect robot would make of it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.increments import Increments, accumulate
from odomcorrupt.study.advice.manoeuvres import Limits
from odomcorrupt.study.recordings.trajectory import Recording, Trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Motion
    from odomcorrupt.pose import Array
    from odomcorrupt.study.advice.manoeuvres import Manoeuvre

__all__ = ["STEP_S", "Plan", "ideal_recording", "plan_of", "safe_limits"]

STEP_S = 0.05
"""Time between two commands."""
_FAST = (0.3, 1.2)
_TURNING = (0.5, 1.2)
_REST_S = 2.0


@dataclass(frozen=True, slots=True)
class Plan:
    """Commands `STEP_S` apart, beginning and ending at rest.

    v_mps, omega_radps : (n,)
    """

    manoeuvre: Manoeuvre
    v_mps: Array
    omega_radps: Array

    @property
    def duration_s(self) -> float:
        """How long it takes, seconds."""
        return len(self.v_mps) * STEP_S

    @property
    def path(self) -> Array:
        """Poses (n + 1, 3) of a robot that follows exactly, from the origin, m and rad."""
        steps = Increments(self.v_mps * STEP_S, np.zeros_like(self.v_mps), self.omega_radps * STEP_S)
        return accumulate(np.zeros(3), steps)

    @property
    def floor_m(self) -> tuple[float, float]:
        """Length and width of the floor that its path covers, metres, the longer first."""
        size = np.ptp(self.path[:, :2], axis=0)
        return float(size.max()), float(size.min())

    @property
    def fastest_mps(self) -> float:
        """Largest speed, m/s."""
        return float(np.abs(self.v_mps).max())

    @property
    def quickest_radps(self) -> float:
        """Largest turn rate, rad/s."""
        return float(np.abs(self.omega_radps).max())


def safe_limits(motions: Sequence[Motion]) -> Limits:
    """Return how fast a robot may be sent: as fast as it has been seen to go, within what is harmless indoors."""
    v = np.concatenate([np.abs(m.v) for m in motions])
    omega = np.concatenate([np.abs(m.omega) for m in motions])
    seen = float(np.quantile(v, 0.98)), float(np.quantile(omega, 0.98))
    return Limits(float(np.clip(seen[0], *_FAST)), float(np.clip(seen[1], *_TURNING)))


def plan_of(manoeuvre: Manoeuvre, limits: Limits, duration_s: float) -> Plan:
    """Return the commands of whole rounds until `duration_s` is over, and at least the manoeuvre's own time."""
    speeds = [np.zeros((round(_REST_S / STEP_S), 2))]
    now, left = np.zeros(2), round(max(duration_s, manoeuvre.least_s) / STEP_S)
    for hold in manoeuvre.round(limits):
        wanted = np.array(hold[:2])
        ramp = max(1, int(np.ceil(np.max(np.abs(wanted - now) / hold.accelerations) / STEP_S)))
        part = np.concatenate((np.arange(1, ramp + 1) / ramp, np.ones(round(hold.hold_s / STEP_S))))
        speeds.append(now + part[:, None] * (wanted - now))
        now, left = wanted, left - len(part)
        if left <= 0:
            break
    down = max(1, int(np.ceil(np.max(np.abs(now) / (0.5, 1.2)) / STEP_S)))
    speeds.append(now * (1.0 - np.arange(1, down + 1) / down)[:, None])
    speeds.append(np.zeros((round(_REST_S / STEP_S), 2)))
    v, omega = np.concatenate(speeds).T
    return Plan(manoeuvre, np.ascontiguousarray(v), np.ascontiguousarray(omega))


def ideal_recording(plan: Plan, like: Recording) -> Recording:
    """Return what a perfect robot, watched by a perfect tracker, would record, from where `like` began."""
    stamps_ns = like.origin_ns + (np.arange(len(plan.v_mps) + 1) * round(STEP_S * 1e9)).astype(np.int64)
    odometry = Trajectory(stamps_ns, plan.path)
    start = np.nan_to_num(like.truth.xyt[0])
    steps = Increments(plan.v_mps * STEP_S, np.zeros_like(plan.v_mps), plan.omega_radps * STEP_S)
    truth = Trajectory(stamps_ns, accumulate(start, steps))
    return Recording(plan.manoeuvre.name, odometry, truth, like.origin_ns, like.track_m)

"""Driving: the body's speed and yaw rate over time, by a driver who knows the robot's pose.

A driver at 20 Hz steers from goal to goal, with limited accelerations, and stops now and then. The motion is the true
one; the odometry is derived from it afterwards, with and without a fault.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ordinary.platforms import Platform

__all__ = ["FINE_HZ", "Route", "driven"]

FINE_HZ = 200.0
"""Rate of the fine time grid on which bodies and wheels move."""
DRIVER_HZ = 20.0


@dataclass(frozen=True, slots=True)
class Route:
    """Goals of a drive.

    kind : "rooms": goals anywhere in a rectangle; "corridor": back and forth between two ends; "left": round a
        rectangle, always to the left
    width_m, height_m : the rectangle
    stops : probability of a stop of 1 to 4 s at a goal
    reverse : probability that a goal is followed by backing up by 0.4 to 1 m
    """

    kind: str
    width_m: float
    height_m: float
    stops: float = 0.4
    reverse: float = 0.15


def driven(
    route: Route, platform: Platform, duration_s: float, rng: np.random.Generator, start: np.ndarray
) -> np.ndarray:
    """Return time (s), forward speed (m/s) and yaw rate (rad/s) of a drive from a pose, shape (n, 3), at 200 Hz."""
    steps = round(duration_s * DRIVER_HZ)
    rows = np.zeros((steps + 1, 2))
    driver = _Driver(route, platform, rng, start)
    for i in range(1, steps + 1):
        rows[i] = driver.step(1.0 / DRIVER_HZ)
    coarse = np.arange(steps + 1) / DRIVER_HZ
    fine = np.arange(round(duration_s * FINE_HZ) + 1) / FINE_HZ
    return np.column_stack((fine, np.interp(fine, coarse, rows[:, 0]), np.interp(fine, coarse, rows[:, 1])))


class _Driver:
    """A driver who turns towards a goal, drives there, and slows down before it."""

    def __init__(self, route: Route, platform: Platform, rng: np.random.Generator, start: np.ndarray) -> None:
        self.route, self.platform, self.rng = route, platform, rng
        self.x, self.y, self.theta = (float(number) for number in start)
        self.v = self.w = 0.0
        self.wait_s, self.back_m, self.leg = 1.0, 0.0, 0
        self.car = platform.drive != "differential"
        self._next_goal()

    def step(self, dt: float) -> tuple[float, float]:
        """Advance by one time step and return speed (m/s) and yaw rate (rad/s)."""
        v, w = self._wish()
        p = self.platform
        self.v += float(np.clip(v - self.v, -p.accel * dt, p.accel * dt))
        self.w += float(np.clip(w - self.w, -p.yaw_accel * dt, p.yaw_accel * dt))
        if self.car:
            limit = abs(self.v) / p.turning_radius_m
            self.w = min(max(self.w, -limit), limit)
        self.x += self.v * math.cos(self.theta) * dt
        self.y += self.v * math.sin(self.theta) * dt
        self.theta += self.w * dt
        self.wait_s -= dt
        return self.v, self.w

    def _wish(self) -> tuple[float, float]:
        if self.wait_s > 0.0:
            return 0.0, 0.0
        if self.back_m > 0.0:
            self.back_m -= abs(self.v) / DRIVER_HZ
            return -0.4 * self.speed, 0.2 * self.bend if not self.car else self.bend * abs(self.v) * 0.2
        dx, dy = self.goal[0] - self.x, self.goal[1] - self.y
        far = math.hypot(dx, dy)
        if far < self.near:
            self._arrive()
            return 0.0, 0.0
        bearing = math.remainder(math.atan2(dy, dx) - self.theta, 2.0 * math.pi)
        if self.car:
            slow = 0.4 if abs(bearing) > 0.6 else 1.0
            # a goal inside the turning circle cannot be reached
            if abs(bearing) > 1.0 and far < 2.2 * self.platform.turning_radius_m:
                bearing = 0.0
            return self.speed * slow, 2.0 * bearing * max(self.v, 0.1) / max(2.0 * self.platform.turning_radius_m, 0.5)
        w = float(np.clip(2.0 * bearing, -self.turn, self.turn))
        if abs(bearing) > self.spot:
            if self.route.kind == "left" and bearing < 0.0:
                w = self.turn
            return 0.0, w
        return min(self.speed, math.sqrt(2.0 * 0.5 * self.platform.accel * far) + 0.02) * math.cos(bearing), w

    def _arrive(self) -> None:
        if self.rng.random() < self.route.stops:
            self.wait_s = self.rng.uniform(1.0, 4.0)
        if self.rng.random() < self.route.reverse:
            self.back_m = self.rng.uniform(0.4, 1.0) * (3.0 * self.platform.turning_radius_m if self.car else 1.0)
        self._next_goal()

    def _next_goal(self) -> None:
        r, p = self.route, self.platform
        self.leg += 1
        if r.kind == "corridor":
            self.goal = (r.width_m if self.leg % 2 else 0.0, 0.0)
        elif r.kind == "left":
            corners = ((r.width_m, 0.0), (r.width_m, r.height_m), (0.0, r.height_m), (0.0, 0.0))
            self.goal = corners[(self.leg - 1) % 4]
        else:
            self.goal = (self.rng.uniform(0.0, r.width_m), self.rng.uniform(0.0, r.height_m))
        dull = r.kind != "rooms"
        self.speed = p.top_speed * (0.8 if dull else self.rng.uniform(0.35, 1.0))
        self.turn = p.top_yaw_rate * (0.7 if dull else self.rng.uniform(0.4, 1.0))
        self.spot = 0.5 if dull else self.rng.uniform(0.3, 1.2)
        self.bend = self.rng.uniform(-1.0, 1.0) if not dull else 0.0
        self.near = max(0.08, 0.6 * p.turning_radius_m if self.car else 0.0)

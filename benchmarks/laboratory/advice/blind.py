"""First drives that leave causes ambiguous: one speed, one side, one pass, no reversal, no stop."""

from __future__ import annotations

from dataclasses import replace
from math import cos, pi, sin
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.simulation import Commands
from odomcorrupt.simulation.faults import EVERY
from odomcorrupt.simulation.robot import stream
from odomcorrupt.simulation.sensors import dock

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.study.io.recording import Recording

__all__ = ["BLIND", "first_drive", "on_the_way", "place_of"]

STEP_S = 0.05
"""Time between two commands, seconds."""
LONG_S, SHORT_S = 200.0, 60.0
EDGE_S = 6.0
"""Duration that is cut off both ends of a steady drive, seconds."""
PASS_M = 7.0
PATCH_AHEAD_M, PATCH_RADIUS_M = 4.0, 1.2


def _held(moves: Sequence[tuple[float, float, float]], seconds: float) -> Commands:
    """Repeat moves of (m/s, rad/s, s), each as one step of the command, until the time is over."""
    one = np.concatenate([np.tile((v, omega), (round(hold / STEP_S), 1)) for v, omega, hold in moves])
    n = round(seconds / STEP_S)
    rows = np.tile(one, (-(-n // len(one)), 1))[:n]
    return Commands(np.arange(n) * STEP_S, rows[:, 0].copy(), rows[:, 1].copy())


def _line(v: float, omega: float) -> Commands:  # noqa: ARG001 - straight on
    """Drive straight on at one speed."""
    return _held([(v, 0.0, LONG_S)], LONG_S)


def _circle(v: float, omega: float) -> Commands:
    """Drive one circle, to one side, at one speed."""
    return _held([(v, omega, LONG_S)], LONG_S)


def _slalom(v: float, omega: float) -> Commands:
    """Drive bends to both sides at one speed and one yaw rate, without a stop."""
    half = pi / abs(omega)
    return _held([(v, omega, half), (v, -omega, 2.0 * half), (v, omega, half)], LONG_S)


def _spins(v: float, omega: float) -> Commands:  # noqa: ARG001 - on the spot
    """Turn on the spot to both sides, without travel."""
    return _held([(0.0, omega, 8.0), (0.0, 0.0, 1.0), (0.0, -omega, 8.0), (0.0, 0.0, 1.0)], LONG_S)


def _one_way_square(v: float, omega: float) -> Commands:
    """Drive rectangles with corners on the spot, always to one side, at one speed."""
    return _held([(v, 0.0, 6.0), (0.0, 0.0, 0.6), (0.0, omega, 0.5 * pi / abs(omega)), (0.0, 0.0, 0.6)], LONG_S)


def _stop_and_go(v: float, omega: float) -> Commands:  # noqa: ARG001 - straight
    """Drive straight on with stops, at one speed, with equal starts and stops."""
    return _held([(v, 0.0, 5.0), (0.0, 0.0, 2.0)], LONG_S)


def _there_and_back(v: float, omega: float) -> Commands:  # noqa: ARG001 - straight
    """Drive straight on and back in reverse, at one speed, without a stop in between."""
    return _held([(v, 0.0, 5.0), (-v, 0.0, 5.0)], LONG_S)


def _minute(v: float, omega: float) -> Commands:
    """Drive straights and bends with stops, for a minute."""
    return _held([(v, 0.0, 4.0), (v, omega, 4.0), (0.0, 0.0, 1.0), (v, -omega, 4.0)], SHORT_S)


def _pass(v: float, omega: float) -> Commands:  # noqa: ARG001 - straight on
    """Pass once through a room, slowly."""
    slow = 0.3 * v
    return _held([(slow, 0.0, PASS_M / slow)], PASS_M / slow)


BLIND: dict[str, Callable[[float, float], Commands]] = {
    "line": _line,
    "circle": _circle,
    "slalom": _slalom,
    "spins": _spins,
    "one-way square": _one_way_square,
    "stop and go": _stop_and_go,
    "there and back": _there_and_back,
    "a minute": _minute,
    "one pass": _pass,
}
"""Functions by name that return the commands for a speed (m/s) and a yaw rate (rad/s)."""
_STEADY = ("line", "circle", "slalom")


def first_drive(name: str, seed: int) -> Commands:
    """Return a first drive at a speed, a yaw rate and a side given by a seed."""
    rng = np.random.default_rng([seed, 53])
    v, omega = rng.uniform(0.35, 0.65), rng.uniform(0.35, 0.65) * rng.choice((-1.0, 1.0))
    return BLIND[name](float(v), float(omega))


def on_the_way(name: str, recording: Recording) -> Recording:
    """Return a steady drive without its start and end: such a recording is begun while the robot drives."""
    if name not in _STEADY:
        return recording
    first_s, last_s = recording.odometry_s[[0, -1]] + (EDGE_S, -EDGE_S)

    def within(trajectory: Trajectory) -> Trajectory:
        t_s = trajectory.seconds_since(recording.origin_ns)
        kept = (t_s >= first_s) & (t_s <= last_s)
        return Trajectory(trajectory.stamps_ns[kept], trajectory.xyt[kept])

    odometry = within(recording.odometry)
    origin_ns = int(odometry.stamps_ns[0])
    return replace(recording, odometry=odometry, truth=within(recording.truth), origin_ns=origin_ns)


def place_of(cause: str, seed: int) -> dict[str, float] | None:
    """Return the place of a cause that has one: ahead of the robot's start, so that one pass crosses it."""
    if EVERY[cause].place is None:
        return None
    x, y, theta = dock(stream(seed, "world"))
    return {"x": x + PATCH_AHEAD_M * cos(theta), "y": y + PATCH_AHEAD_M * sin(theta), "radius": PATCH_RADIUS_M}

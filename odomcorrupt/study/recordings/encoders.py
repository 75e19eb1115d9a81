"""What the encoders did, seen in the odometry alone: increments that were lost, and coarse ticks."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import effect_from_values
from odomcorrupt.increments import Increments, accumulate, increments
from odomcorrupt.study.recordings.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.pose import Array
    from odomcorrupt.study.recordings.trajectory import Recording

__all__ = ["encoder_effects", "refilled"]

_MOVING_MPS = 0.05
_ARM_M = 0.2
"""How far wheels are from the middle, about: a turn on the spot moves them, too."""
_FEWEST_LOST = 5
_LEAST_LOST = 5e-4
_CAUGHT_UP = 1.35
_STEPS_M = np.geomspace(1e-3, 0.05, 600)
"""Ticks finer than a millimetre bound the error to less than the truth can tell."""
_LATTICE = 0.9
_RESTLESS = 0.05
_STILL_M = 1e-6


def encoder_effects(recording: Recording) -> list[Effect]:
    """Return lost increments and coarse ticks where the odometry shows them, with their parameters."""
    step = _tick(recording)
    if step is not None:
        # coarse ticks stand still between two counts: nothing is lost there
        return [effect_from_values("quantization", {"step": step})]
    lost, moving = _lost(recording)
    if lost.sum() >= _FEWEST_LOST and lost.sum() > _LEAST_LOST * moving:
        return [effect_from_values("lost_increments", {"fraction": float(lost.sum() / moving)})]
    return []


def refilled(recording: Recording, effects: Sequence[Effect]) -> Recording:
    """Return the recording with lost increments filled with the mean of their neighbours, where effects name them."""
    lost, _ = _lost(recording)
    if not lost.any() or not any(effect.name == "lost_increments" for effect in effects):
        return recording
    steps = increments(recording.odometry.xyt)
    rows = np.stack((steps.ds_m, steps.dl_m, steps.dtheta_rad), axis=1)
    at = np.flatnonzero(lost)
    rows[at] = 0.5 * (rows[at - 1] + rows[at + 1])
    xyt = accumulate(recording.odometry.xyt[0], Increments(*np.ascontiguousarray(rows.T)))
    return replace(recording, odometry=Trajectory(recording.odometry.stamps_ns, xyt))


def _lost(recording: Recording) -> tuple[NDArray[np.bool_], int]:
    """Return which increments (n,) stand still alone between neighbours that move, and how many move at all."""
    steps = increments(recording.odometry.xyt)
    way = np.hypot(steps.ds_m, steps.dl_m) + _ARM_M * np.abs(steps.dtheta_rad)
    speed = way / np.diff(recording.odometry_s)
    still = (np.abs(steps.ds_m) < 1e-12) & (np.abs(steps.dl_m) < 1e-12) & (np.abs(steps.dtheta_rad) < 1e-12)
    moving = speed > _MOVING_MPS
    lost = np.zeros(len(steps), dtype=bool)
    # a count that only came late is caught up by a neighbour: the two beside it then go farther than those around them
    caught_up = way[1:-3] + way[3:-1] > _CAUGHT_UP * (way[:-4] + way[4:])
    lost[2:-2] = still[2:-2] & moving[1:-3] & moving[3:-1] & ~caught_up
    return lost, max(int(moving.sum() + lost.sum()), 1)


def _tick(recording: Recording) -> float | None:
    """Return the wheel travel of a tick, where the increments lie on a lattice.

    Those of both wheels, where they tell the heading, too; or those of the robot, which goes half a tick with each.
    """
    steps = increments(recording.odometry.xyt)
    found = None
    if recording.track_m is not None:
        turn = steps.dtheta_rad * recording.track_m / 2.0
        found = _lattice((steps.ds_m + turn, steps.ds_m - turn))
    if found is None:
        half = _lattice((steps.ds_m,))
        found = 2.0 * half if half is not None else None
    return found


def _lattice(travels: Sequence[Array]) -> float | None:
    """Return the coarsest step that all travels (n,) are multiples of, if there is one that they change by."""
    lattices = []
    for travel in travels:
        moved = travel[np.abs(travel) > _STILL_M][:1500]
        if len(moved) < 200:
            return None
        # a wheel that has moved at all has moved by a tick: coarser lattices than that only seem to fit small numbers
        possible = np.quantile(np.abs(moved), 0.05) > 0.5 * _STEPS_M
        lattices.append(np.where(possible, _regularity(moved), 0.0))
    common = np.min(lattices, axis=0)
    on = np.flatnonzero(common > _LATTICE)
    if not len(on):
        return None
    # a lattice of s is one of s/2, too: the coarsest is meant, at its own peak
    last = on[-1]
    near = on[_STEPS_M[on] > 0.9 * _STEPS_M[last]]
    step = float(_STEPS_M[near[np.argmax(common[near])]])
    # a robot that keeps one speed goes the same way every time, without ticks: with them, counts come and go
    restless = min(_restless(travel, step) for travel in travels)
    return step if restless > _RESTLESS else None


def _restless(travel: Array, step: float) -> float:
    """Return how often travel (n,) changes by a step, of all the times that it moves."""
    moving = (np.abs(travel[1:]) > _STILL_M) | (np.abs(travel[:-1]) > _STILL_M)
    return float(np.mean(np.abs(np.diff(travel))[moving] > 0.5 * step))


def _regularity(travel: Array) -> Array:
    """Return how much travel (n,) clusters at multiples of each step: 1 for a lattice, about 0 for none."""
    return np.array([np.mean(np.cos(2.0 * np.pi * travel / step)) for step in _STEPS_M])

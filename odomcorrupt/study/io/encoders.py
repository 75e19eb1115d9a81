"""What the encoders did, seen in the odometry alone: increments that were lost, and coarse ticks."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.lost_increments import losses
from odomcorrupt.geometry.increments import accumulate, increments
from odomcorrupt.geometry.motion import corrected_increments, motion_of
from odomcorrupt.study.io.recording import Trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.recording import Recording

__all__ = ["encoder_effects", "hides_losses", "restore_lost"]

_FEWEST_LOST = 5
_LEAST_LOST = 5e-4
_MOSTLY = 0.5
"""Part of the moving increments that are too few ticks to show a loss, from which on none is expected to be seen."""
_STEPS_M = np.geomspace(1e-3, 0.05, 600)
"""Ticks finer than a millimetre bound the error to less than the truth resolves."""
_LATTICE = 0.9
_RESTLESS = 0.05
_STILL_M = 1e-6


def encoder_effects(recording: Recording) -> list[Effect]:
    """Return lost increments and coarse ticks where the odometry shows them, with their parameters."""
    found = []
    shown = losses(motion_of(recording.odometry_s, recording.odometry.xyt, track_m=recording.track_m))
    if shown.seen >= _FEWEST_LOST and shown.fraction > _LEAST_LOST:
        found.append(effect_from_values("lost_increments", {"fraction": shown.fraction}))
    step = _tick(recording)
    if step is not None:
        found.append(effect_from_values("quantization", {"step": step}))
    return found


def hides_losses(recording: Recording) -> bool:
    """Return whether ticks are so coarse that most lost increments would pass for zeros between two counts."""
    shown = losses(motion_of(recording.odometry_s, recording.odometry.xyt, track_m=recording.track_m))
    return shown.hidden > _MOSTLY and _tick(recording) is not None


def restore_lost(recording: Recording, effects: Sequence[Effect]) -> Recording:
    """Return the recording with what its own odometry shows put right, where effects name it."""
    restorable = [effect for effect in effects if effect.restorable]
    if not restorable:
        return recording
    motion = motion_of(recording.odometry_s, recording.odometry.xyt, track_m=recording.track_m)
    xyt = accumulate(recording.odometry.xyt[0], corrected_increments(restorable, motion))
    return replace(recording, odometry=Trajectory(recording.odometry.stamps_ns, xyt))


def _tick(recording: Recording) -> float | None:
    """Return the wheel travel of a tick, where the increments lie on a lattice.

    Those of both wheels, where these give the heading, too; or those of the robot, which goes half a tick with each.
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

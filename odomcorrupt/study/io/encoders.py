"""Faults of encoders and gyros that the odometry shows: lost increments, coarse ticks, and a dead band of turns.

Odometry at a high message rate, which takes time and memory but shows no further causes of drift, is thinned. The poses
that remain, and the motions between them, are unchanged.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.compensation import corrected_increments
from odomcorrupt.effects.counts import LEAST_WHEEL_TICKS, losses, wheel_losses
from odomcorrupt.effects.wheels import rims_of
from odomcorrupt.geometry.motion import has_steps_of_speed, motion_of, step_of
from odomcorrupt.geometry.se2 import accumulate, increments
from odomcorrupt.geometry.trajectory import Trajectory

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.geometry.motion import Motion
    from odomcorrupt.study.io.recording import Recording

_MIN_LOST = 5
_MIN_LOST_FRACTION = 5e-4  # fraction of the increments
_FAST_SHARE = 0.125
"""Least share of losses at speeds above the median: half is expected, and none of a driver that cuts off low speeds."""
_MAX_HIDDEN = 0.5
"""If a larger part of the moving increments has too few ticks to show a loss, losses count as undetectable."""
_LEAST_TICK_M = 1e-3
"""Least tick that matters, metres: the error of smaller ones is below what the truth resolves."""


def encoder_effects(recording: Recording) -> list[Effect]:
    """Return `lost_increments`, `quantization` and `gyro_dead_band`, with parameters, if the odometry shows them."""
    found = _losses(motion_of(recording.odometry_s, recording.odometry.xyt, track_m=recording.track_m))
    step = tick_of(recording)
    if step is not None:
        found.append(effect_from_values("quantization", {"step": step}))
    if recording.yaw_dead_band_radps:
        found.append(effect_from_values("gyro_dead_band", {"threshold": recording.yaw_dead_band_radps}))
    return found


def _losses(motion: Motion) -> list[Effect]:
    """Return `lost_increments` of the robot or, if most losses are of single wheels, of each wheel that shows them."""
    whole, wheels = losses(motion), wheel_losses(motion, motion.track_m, LEAST_WHEEL_TICKS)
    if wheels is not None and sum(wheels.alone) > whole.seen:
        track = {} if motion.track_m else {"track": wheels.track_m}
        single = [
            effect_from_values("lost_increments", {"fraction": shown.fraction, "wheel": wheel, **track})
            for wheel, shown, alone in zip(("right", "left"), wheels[:2], wheels.alone, strict=True)
            if alone >= _MIN_LOST and alone > _MIN_LOST_FRACTION * shown.of and shown.fast >= _FAST_SHARE
        ]
        if single:
            return single
    if whole.seen >= _MIN_LOST and whole.fraction > _MIN_LOST_FRACTION:
        return [effect_from_values("lost_increments", {"fraction": whole.fraction})]
    return []


def hides_losses(recording: Recording) -> bool:
    """Return whether ticks are so coarse that most lost increments look like zeros between two counts."""
    shown = losses(motion_of(recording.odometry_s, recording.odometry.xyt, track_m=recording.track_m))
    return shown.hidden > _MAX_HIDDEN and tick_of(recording) is not None


def restore_lost(recording: Recording, effects: Sequence[Effect]) -> Recording:
    """Return the recording with its odometry corrected for those effects that the odometry alone can restore."""
    if not (restorable := [effect for effect in effects if effect.restorable]):
        return recording
    motion = motion_of(recording.odometry_s, recording.odometry.xyt, track_m=recording.track_m)
    xyt = accumulate(recording.odometry.xyt[0], corrected_increments(restorable, motion))
    return recording.with_odometry(Trajectory(recording.odometry.stamps_ns, xyt))


def tick_of(recording: Recording) -> float | None:
    """Return the wheel travel per tick, metres, or None if the increments are no multiples of a tick.

    With a known track, both wheels are tested. Otherwise the robot's travel is, which is half a tick per wheel tick,
    unless yaw rates come in steps of their own: then speeds are truncated to steps.
    """
    steps, dt_s = increments(recording.odometry.xyt), np.diff(recording.odometry_s)
    # at one speed, travels over one interval and over two are multiples without any ticks
    usual = np.abs(dt_s - np.median(dt_s)) < 0.5 * np.median(dt_s)
    if recording.track_m is not None:
        rims = rims_of(steps.ds_m[usual], steps.dtheta_rad[usual], recording.track_m)
        ticks = [tick for rim in rims if (tick := step_of(rim)) is not None]
        if len(ticks) > 1 and np.ptp(ticks) < 0.01 * ticks[0] and ticks[0] >= _LEAST_TICK_M:
            return ticks[0]
    half = step_of(steps.ds_m[usual])
    return None if half is None or 2.0 * half < _LEAST_TICK_M or speeds_in_steps(recording) else 2.0 * half


def speeds_in_steps(recording: Recording) -> bool:
    """Return whether all speeds and yaw rates are whole multiples of steps that are no ticks; needs the track."""
    if recording.track_m is None:
        return False
    steps, dt_s = increments(recording.odometry.xyt), np.diff(recording.odometry_s)
    rate = np.divide(1.0, dt_s, out=np.zeros_like(dt_s), where=dt_s > 0.0)
    return has_steps_of_speed(steps.ds_m * rate, steps.dtheta_rad * rate, dt_s, recording.track_m)


_PERIOD_S = 0.02
"""Longest interval after thinning, s. With twice as long ones, estimated lags were 3 to 5 ms too short."""
_JITTER = 1e-3
"""Relative tolerance of that interval."""


def thinned(recordings: Sequence[Recording]) -> list[Recording]:
    """Return recordings with every n-th pose of odometry whose rate is 100 Hz or more, so that 50 to 100 Hz remain.

    Odometry whose single messages lost motion, or parts of steps of speed, is unchanged, because these are restored or
    recognised by message. Stretches of one run continue to share its odometry.
    """
    known: dict[int, Trajectory] = {}
    found = []
    for recording in recordings:
        odometry = recording.odometry
        period_s = 1e-9 * float(np.median(np.diff(odometry.stamps_ns)))
        every = int(_PERIOD_S * (1.0 + _JITTER) / period_s)
        lost = any(effect.name != "quantization" for effect in encoder_effects(recording)) if every > 1 else False
        if every < 2 or lost or speeds_in_steps(recording):
            found.append(recording)
            continue
        few = known.setdefault(id(odometry), odometry.only(slice(None, None, every)))
        said = f"odometry at {1.0 / period_s:.0f} Hz: one pose of {every} is used"
        found.append(replace(recording.with_odometry(few), notes=(*recording.notes, said)))
    return found

"""Thinning of odometry at a high message rate, which takes time and memory but shows no further causes of drift.

The poses that remain, and the motions between them, are unchanged.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.study.io.encoders import encoder_effects, speeds_in_steps

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.study.io.recording import Recording

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
        every = int(_PERIOD_S * (1.0 + _JITTER) * _rate_hz(odometry))
        if every < 2 or _acts_per_message(recording):
            found.append(recording)
            continue
        few = known.setdefault(id(odometry), odometry.only(slice(None, None, every)))
        said = f"odometry at {_rate_hz(odometry):.0f} Hz: one pose of {every} is used"
        found.append(replace(recording.with_odometry(few), notes=(*recording.notes, said)))
    return found


def _acts_per_message(recording: Recording) -> bool:
    """Return whether each message may have lost something: its motion, or a part of a step of speed."""
    lost = any(effect.name != "quantization" for effect in encoder_effects(recording))
    return lost or speeds_in_steps(recording)


def _rate_hz(odometry: Trajectory) -> float:
    """Return the usual message rate, Hz; 0 if most stamps are equal."""
    if len(odometry) < 2:
        return 0.0
    period_s = 1e-9 * float(np.median(np.diff(odometry.stamps_ns)))
    return 1.0 / period_s if period_s > 0.0 else 0.0

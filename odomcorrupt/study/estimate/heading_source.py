"""Source of the odometry's heading, as shown by a gyro in the bag or by turns at rest, and the effects it rules out.

The aliases `wheelbase` and `gyro_scale` are the same yaw gain. A gyro beside the truth shows whether the odometry's
heading comes from the wheels or from a gyro, and so which of the two effects is meant. If a gyro is the only truth,
travel is not measured, and a bias of the yaw rate may be the bias of that gyro.

Without a gyro in the bag, a heading that goes on changing while no wheel turns comes from a gyro, with its noise and
bias. A heading from wheels stands still then, except for the decay of a filter's lag.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import increments

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.io.recording import Recording

GAINS_OF_TURNS = {"wheels": "wheelbase", "gyro": "gyro_scale"}  # yaw gain of each source of the heading
_OF_TRAVEL = ("wheel_scale", "speed_scale", "scale_drift", "sideways_scale", "slope", "lever_arm", "mount_yaw")
_GYROS = ("gyro_bias", "gyro_bias_walk")
_STILL_M, _STILL_RADPS = 1e-9, 0.02
"""Largest travel of a step at rest, m, and largest yaw rate, rad/s: above usual biases, below turns on the spot."""
_SPELL_S, _RESTS_S = 1.0, 2.0
"""Shortest rest, s, and total of all rests that shows whether the heading changes in them."""
_GOES_ON = 0.5
"""Least turn in the second half of a rest relative to that in the first half; less is the decay of a lag."""


def heading_source_of(recordings: Sequence[Recording]) -> str:
    """Return the source of the odometry's heading, "wheels" or "gyro"; "" if unknown or different in recordings."""
    sources = {recording.heading_source for recording in recordings}
    return sources.pop() if len(sources) == 1 else ""


def turns_at_rest(recording: Recording) -> bool:
    """Return whether the heading of the odometry goes on changing in at least half the time at which no wheel turns."""
    rests_s, going_on_s = _rests(recording)
    return rests_s >= _RESTS_S and going_on_s >= 0.5 * rests_s


def stands_still(recording: Recording) -> bool:
    """Return whether the heading of the odometry stands still while no wheel turns: there are rests that show it."""
    rests_s, going_on_s = _rests(recording)
    return rests_s >= _RESTS_S and not going_on_s


def _rests(recording: Recording) -> tuple[float, float]:
    """Return the time at which no wheel turns, and that in which the heading of the odometry goes on changing, s."""
    steps, dt_s = increments(recording.odometry.xyt), np.diff(recording.odometry_s)
    turned = np.abs(steps.dtheta_rad)
    still = (np.hypot(steps.ds_m, steps.dl_m) < _STILL_M) & (turned < _STILL_RADPS * dt_s)
    ends = np.flatnonzero(np.diff(np.concatenate(([0], still, [0])))).reshape(-1, 2)
    rests_s = going_on_s = 0.0
    for first, last in ends.tolist():
        seconds, middle = float(dt_s[first:last].sum()), (first + last) // 2
        if seconds >= _SPELL_S:
            early, late = float(turned[first:middle].sum()), float(turned[middle:last].sum())
            rests_s += seconds
            going_on_s += seconds * (late > _GOES_ON * early > 0.0)
    return rests_s, going_on_s


def sees_travel(recordings: Sequence[Recording]) -> bool:
    """Return whether any truth measured travel."""
    return any(recording.positioned for recording in recordings)


def is_nameable(kind: type[Effect], source: str, *, travel: bool) -> bool:
    """Return whether an effect can be named: of the two yaw gains, only that of a known source of the heading.

    travel : whether any truth measured travel; otherwise effects of travel and biases of gyros are excluded
    """
    if not travel and kind.name in (*_OF_TRAVEL, *_GYROS):
        return False
    return not source or kind.name not in GAINS_OF_TURNS.values() or is_yaw_gain_of(kind, source)


def is_yaw_gain_of(kind: type[Effect], source: str) -> bool:
    """Return whether an effect is the yaw gain of a known source of the heading."""
    return kind.name == GAINS_OF_TURNS.get(source)

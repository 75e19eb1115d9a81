"""Source of the odometry's heading, as shown by a gyro in the bag, and the effects that it rules out.

The aliases `wheelbase` and `gyro_scale` are the same yaw gain. A gyro beside the truth shows whether the odometry's
heading comes from the wheels or from a gyro, and so which of the two effects is meant. If a gyro is the only truth,
travel is not measured, and a bias of the yaw rate may be the bias of that gyro.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.io.recording import Recording

GAINS_OF_TURNS = {"wheels": "wheelbase", "gyro": "gyro_scale"}  # yaw gain of each source of the heading
_OF_TRAVEL = ("wheel_scale", "speed_scale", "scale_drift", "sideways_scale", "slope", "lever_arm", "mount_yaw")
_GYROS = ("gyro_bias", "gyro_bias_walk")


def heading_source_of(recordings: Sequence[Recording]) -> str:
    """Return the source of the odometry's heading, "wheels" or "gyro"; "" if unknown or different in recordings."""
    sources = {recording.heading_source for recording in recordings}
    return sources.pop() if len(sources) == 1 else ""


def sees_travel(recordings: Sequence[Recording]) -> bool:
    """Return whether any truth measured travel."""
    return any(recording.positioned for recording in recordings)


def is_nameable(kind: type[Effect], source: str, *, travel: bool) -> bool:
    """Return whether an effect can be named: of the two yaw gains, only that of a known source of the heading.

    travel : whether any truth measured travel; otherwise effects of travel and biases of gyros are excluded
    """
    if not travel and kind.name in (*_OF_TRAVEL, *_GYROS):
        return False
    return not source or kind.name not in GAINS_OF_TURNS.values() or is_settled(kind, source)


def is_settled(kind: type[Effect], source: str) -> bool:
    """Return whether an effect is the yaw gain of a known source of the heading."""
    return kind.name == GAINS_OF_TURNS.get(source)

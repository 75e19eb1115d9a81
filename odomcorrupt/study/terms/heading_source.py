"""Which effects may be named: what a gyro in the bag settles of the odometry's heading, and what it cannot see.

The twins `wheelbase` and `gyro_scale` are one error of turns with two readings. A gyro beside the truth shows whether
the odometry's heading comes from the wheels or from a gyro, and with it which of the two is meant. Where a gyro is the
only witness, travel is not seen at all, and a bias of the yaw rate may as well be its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.effects.effect import choices

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.terms.term import LibraryTerm

__all__ = ["GAINS_OF_TURNS", "heading_source_of", "is_nameable", "is_settled", "sees_travel", "with_known_heading"]

GAINS_OF_TURNS = {"wheels": "wheelbase", "gyro": "gyro_scale"}
_OF_TRAVEL = ("wheel_scale", "speed_scale", "scale_drift", "sideways_scale", "slope", "lever_arm", "mount_yaw")
_GYROS = ("gyro_bias", "gyro_bias_walk")


def heading_source_of(recordings: Sequence[Recording]) -> str:
    """Return where the odometry's heading comes from, "wheels" or "gyro"; "" where not all recordings show the same."""
    sources = {recording.heading_source for recording in recordings}
    return sources.pop() if len(sources) == 1 else ""


def sees_travel(recordings: Sequence[Recording]) -> bool:
    """Whether any truth measured travel."""
    return any(recording.positioned for recording in recordings)


def is_nameable(kind: type[Effect], source: str, *, travel: bool) -> bool:
    """Whether a witness of turns lets an effect be named: of two gains of turns the one of the heading's source.

    travel : whether any truth measured travel
    """
    if not travel and kind.name in (*_OF_TRAVEL, *_GYROS):
        return False
    return not source or kind.name not in GAINS_OF_TURNS.values() or is_settled(kind, source)


def is_settled(kind: type[Effect], source: str) -> bool:
    """Whether an effect is the gain of turns that the heading's source has."""
    return kind.name == GAINS_OF_TURNS.get(source)


def with_known_heading(family: tuple[LibraryTerm, ...], source: str) -> tuple[LibraryTerm, ...]:
    """Return the shapes of an effect whose heading comes from where the odometry's does; all where that is unknown."""
    if not source:
        return family
    return tuple(t for t in family if "heading" not in choices(t.start) or getattr(t.start, "heading", "") == source)

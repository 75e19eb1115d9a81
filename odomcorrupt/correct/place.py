"""Effects that ask where the robot is: their places are the truth's, and the odometry's frame may lie elsewhere."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np

from odomcorrupt.effects.user import UserEffect
from odomcorrupt.motion import error_of, motion_of

if TYPE_CHECKING:
    from odomcorrupt.effects.effect import Effect, Motion

__all__ = ["asks_for_places"]

_PLACES = frozenset({"x", "y", "theta"})


class _Listening:
    """A motion that remembers what it was asked for."""

    def __init__(self, motion: Motion) -> None:
        self._motion = motion
        self.asked: set[str] = set()

    def __getattr__(self, name: str) -> Any:
        self.asked.add(name)
        return getattr(self._motion, name)

    def __len__(self) -> int:
        return len(self._motion)


def asks_for_places(effect: Effect) -> bool:
    """Whether an effect's f depends on the robot's place or heading in the frame of the truth."""
    if not effect.reads_truth:
        return False
    if isinstance(effect, UserEffect):  # it is shown all variables there are, and says which ones it uses
        return not effect.expression.names.isdisjoint(_PLACES)
    drive = np.cumsum(np.full((4, 3), 0.1), axis=0)
    motion = _Listening(motion_of(np.arange(4.0), drive, track_m=0.4))
    error_of(effect, cast("Motion", motion))
    return not motion.asked.isdisjoint(_PLACES)

"""Stamps put back to where they were before a clock was wrong."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from odomcorrupt.effects.effect import Effect, Kind, Motion, State, TwistError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

__all__ = ["ClockInverse", "true_stamps"]

ROUNDS = 60
"""A clock is at most a tenth too fast, so each round gains a digit."""


@dataclass(frozen=True, slots=True)
class ClockInverse(Effect):
    """The opposite of clock effects: it shifts a stamp back by as much as they shifted it."""

    name: ClassVar[str] = "clock_inverse"
    kind: ClassVar[Kind] = "setup"
    summary: ClassVar[str] = "stamps put back"
    clock: ClassVar[bool] = True

    clocks: tuple[Effect, ...] = ()

    @property
    def acts(self) -> bool:
        """Whether there is a clock to put right."""
        return any(clock.acts for clock in self.clocks)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return nothing: it moves stamps alone."""
        return TwistError(np.zeros((len(motion), 3)), state)

    def stamp_shift_s(self, t_s: Array) -> Array:
        """Return by how much (n,) seconds to shift stamps that read t_s (n,) after the first one."""
        true_s = t_s.copy()
        for _ in range(ROUNDS):
            true_s = t_s - (self._shift_s(true_s) - self._shift_s(np.zeros(1)))
        return -self._shift_s(true_s)

    def _shift_s(self, t_s: Array) -> Array:
        shift_s: Array = np.zeros_like(t_s)
        for clock in self.clocks:
            shift_s = shift_s + clock.stamp_shift_s(t_s)
        return shift_s


def true_stamps(clocks: Sequence[Effect], stamps_ns: NDArray[np.int64], first_ns: int) -> NDArray[np.int64]:
    """Return stamps (n,) as they were before the clocks were wrong; first_ns is the first that the clocks wrote."""
    right = ClockInverse(tuple(clocks))
    if not right.acts:
        return stamps_ns
    shift_s = right.stamp_shift_s((stamps_ns - first_ns) * np.float64(1e-9))
    return stamps_ns + np.rint(shift_s * 1e9).astype(np.int64)

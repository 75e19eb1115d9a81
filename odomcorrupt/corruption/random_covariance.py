"""What random effects do to a path's uncertainty, to first order, as running sums that follow those of the noise.

An effect that draws is a number that wanders times an error that is known (`Effect.gains`). What the number has done
since the path began are five sums: of the shifts in x and y, and of the turns times 1, x and y of where they were
made. Their covariance grows by each interval's own part and by what the number remembers of the intervals before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.effects.effect import Motion
from odomcorrupt.effects.random_state import autoregression

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.effects.effect import Effect, Gain
    from odomcorrupt.geometry.se2 import Array

__all__ = ["WANDER", "Grown", "Wander", "wandered_covariance", "wanders"]

_FIRST, _SECOND = np.triu_indices(5)

WANDER = len(_FIRST)
"""Rows of the running sums: covariances of the five, row by row of the upper triangle."""

_BODY_FIRST, _BODY_SECOND = np.array([0, 0, 1, 0, 1, 2]), np.array([0, 1, 1, 2, 2, 2])


@dataclass(frozen=True, slots=True)
class _Memory:
    """Variance of a number now, and its covariance (5,) with the five sums."""

    variance: float
    with_sums: Array


class Grown(NamedTuple):
    """What n intervals add.

    path : (WANDER, n) to the running sums
    body : (6, n), of each interval's own error in the body: xx, xy, yy, x-yaw, y-yaw, yaw-yaw
    """

    path: Array
    body: Array


def wanders(effect: Effect, track_m: float | None) -> bool:
    """Whether an effect draws something whose variance it states."""
    none = np.zeros(0)
    still = Motion(
        none, none, none, none, none, np.zeros((0, 3)), none, none, none, none, track_m=track_m
    )  # fmt: skip
    return effect.acts and bool(effect.gains(still))


class Wander:
    """Follows the numbers of all random effects from batch to batch; any cut gives the same bits."""

    def __init__(self) -> None:
        self._memories: list[_Memory] = []

    def restart(self) -> None:
        """Begin a new path; the numbers go on."""
        self._memories = [_Memory(memory.variance, np.zeros(5)) for memory in self._memories]

    def grow(self, gains: tuple[Gain, ...], dt_s: Array, middle_xy: Array, travel_rad: Array) -> Grown:
        """Return what n intervals add.

        Parameters
        ----------
        gains : tuple of Gain
            The same ones, in the same order, at every call.
        dt_s : (n,)
            Lengths of the intervals, seconds.
        middle_xy : (2, n)
            Noisy positions half-way, metres from the path's start.
        travel_rad : (n,)
            Where the body's x axis points while it translates.

        """
        if not self._memories:
            self._memories = [_Memory(gain.start, np.zeros(5)) for gain in gains]
        c, s = np.cos(travel_rad), np.sin(travel_rad)
        path, body = np.zeros((WANDER, len(dt_s))), np.zeros((6, len(dt_s)))
        memories = []
        for gain, memory in zip(gains, self._memories, strict=True):
            along, left, yaw = (gain.f * dt_s[:, None]).T
            own = np.stack((c * along - s * left, s * along + c * left, yaw, yaw * middle_xy[0], yaw * middle_xy[1]))
            variance = autoregression(memory.variance, gain.keep**2, gain.kick)
            with_sums = np.stack([
                np.concatenate(([before], autoregression(float(before), gain.keep, kick)))
                for before, kick in zip(memory.with_sums, own * variance, strict=True)
            ])  # fmt: skip
            old = gain.keep * with_sums[:, :-1]
            path += own[_FIRST] * old[_SECOND] + own[_SECOND] * old[_FIRST] + own[_FIRST] * own[_SECOND] * variance
            error = np.stack((along, left, yaw))
            body += error[_BODY_FIRST] * error[_BODY_SECOND] * variance
            last = float(variance[-1]) if len(variance) else memory.variance
            memories.append(_Memory(last, with_sums[:, -1].copy()))
        self._memories = memories
        return Grown(path, body)


def wandered_covariance(sums: NDArray[np.float64], xy_m: Array) -> Array:
    """Return covariances (n, 3, 3) of x, y, yaw in odom axes, from sums (WANDER, n) and positions (2, n)."""
    n = sums.shape[1]
    five = np.empty((n, 5, 5))
    five[:, _FIRST, _SECOND] = five[:, _SECOND, _FIRST] = sums.T
    reach = np.zeros((n, 3, 5))
    reach[:, 0, 0] = reach[:, 1, 1] = reach[:, 2, 2] = reach[:, 0, 4] = 1.0
    reach[:, 1, 3] = -1.0
    reach[:, 0, 2], reach[:, 1, 2] = -xy_m[1], xy_m[0]
    grown: Array = reach @ five @ reach.transpose(0, 2, 1)
    return (grown + grown.transpose(0, 2, 1)) / 2.0

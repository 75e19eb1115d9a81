"""Quantisation of wheel travel to encoder ticks."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Moments, Motion, Recorded, State, TwistError, parameter, stacked
from odomcorrupt.effects.random_state import copied
from odomcorrupt.effects.wheels import Rims, body_of, needed_track_m, rims_of

if TYPE_CHECKING:
    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array


class _Count(NamedTuple):
    """Travel of each wheel so far, metres, from a random phase between two ticks."""

    right: float
    left: float


@dataclass(frozen=True, slots=True)
class Quantization(Effect):
    """Each wheel reports whole ticks: its total travel rounded down to a multiple of `step`, from a random phase.

    The remainder of one increment appears in a later one, so the error is bounded. It is not a function of the reported
    motion and cannot be undone: f = 0 for correction and study, where it counts as noise.
    """

    name = "quantization"
    kind = "noise"
    layer = "record"
    needs_track = True
    summary = "wheels report whole ticks"
    about = About(
        equation="reported travel of a wheel = step floor(travel / step + phase)",
        typical="0.1 to 2 mm of wheel travel a tick",
        source="uniform quantization, as in any text on signal processing (Widrow & Kollar 2008)",
        confused_with=("heavy_tails",),
        drive="drive very slowly: increments then come in a lattice, in the odometry alone",
    )

    step: float = parameter("m", "wheel travel of one tick", low=0.0, high=0.1, typical=0.0005)

    def start(self, rng: Generator) -> State:
        """Return a random phase between two ticks for each wheel."""
        right, left = copied(rng).uniform(size=2)
        return _Count(float(self.step * right), float(self.step * left))

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f = 0: the rounding is not a function of the reported motion."""
        return TwistError(np.zeros((len(motion), 3)), state)

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - at any time
        """Return increments of whole ticks; the sideways travel of holonomic robots is unchanged."""
        track = needed_track_m(self.name, track_m)
        if self.step == 0.0:
            return Recorded(steps, state)
        ends, counted = [], []
        for travel, before in zip(rims_of(steps[:, 0], steps[:, 2], track), state, strict=True):
            so_far = np.cumsum(np.concatenate(([before], travel)))
            ends.append(float(so_far[-1]))
            counted.append(self.step * np.diff(np.floor(so_far / self.step)))
        reported = body_of(Rims(*counted), track)
        reported[:, 1] = steps[:, 1]
        return Recorded(reported, _Count(*ends))

    def moments(self, motion: Motion) -> Moments:
        """Return zero mean, and the variance of a tick count with uniformly random phase."""
        track = needed_track_m(self.name, motion.track_m)
        ticks = [np.abs(u) * motion.dt_s / self.step for u in rims_of(motion.v, motion.omega, track)]
        over = [t - np.floor(t) for t in ticks]
        single = self.step**2 * sum(p * (1.0 - p) for p in over)
        rate = np.divide(1.0, motion.dt_s, out=np.zeros_like(motion.dt_s), where=motion.dt_s > 0.0) ** 2
        variance = stacked(single * rate / 4.0, 0.0, single * rate / track**2, motion.v)
        return Moments(np.zeros((len(motion), 3)), variance)

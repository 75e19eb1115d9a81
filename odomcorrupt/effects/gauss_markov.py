"""Scale error that varies as a first-order Gauss-Markov process: tyre pressure, load, floor, any correlated cause."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.effects.effect import (
    About,
    ByRows,
    Effect,
    Moments,
    Motion,
    RandomCoefficient,
    State,
    TwistError,
    choice,
    parameter,
    stacked,
)
from odomcorrupt.effects.random_state import autoregression, copied

if TYPE_CHECKING:
    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array


_MOST = 0.9
"""Limit of the gain: beyond 1 the robot would stand or reverse while its wheels roll forwards."""


class _Gain(NamedTuple):
    rng: Generator
    normal: float


@dataclass(frozen=True, slots=True)
class GaussMarkov(Effect):
    """f = g (v, 0, 0), g (0, 0, omega) or g (0, 0, v / 1 m), g' = -g / tau + white noise, of deviation sigma.

    Unlike a bias it vanishes at rest. The gain is limited to 0.9, so that an odometry exists for every motion. The last
    form is a difference between the gains of both wheels: they differ by g b on a track of b metres.
    """

    name = "gauss_markov"
    kind = "noise"
    summary = "the gain of travel, of turns or of one wheel varies slowly about one (Gauss-Markov)"
    about = About(
        equation="f_along = g v, f_yaw = g omega, or f_yaw = g v / 1 m (wheels); g Gauss-Markov of deviation sigma and "
        "correlation time tau",
        typical="1 to 5 % with correlation times of 2 to 30 s (an estimate)",
        source="first-order Gauss-Markov process, as in Gelb 1974, Applied Optimal Estimation",
        confused_with=("slip_burst", "region_slip", "scale_drift", "gyro_bias_walk"),
        drive="drive for long and return to the same places: errors that depend on the place recur, this one does not",
    )

    sigma: float = parameter("", "standard deviation of the gain", low=0.0, high=0.5, typical=0.02)
    tau: float = parameter("s", "correlation time", low=0.05, high=1e4, typical=5.0, identity=5.0, amplitude=False)
    channel: str = choice("what the gain acts on", "along", "yaw", "wheels")

    def start(self, rng: Generator) -> State:
        """Return a gain drawn from its stationary distribution (in units of sigma), and its random generator."""
        rng = copied(rng)
        return _Gain(rng, float(rng.standard_normal()))

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the gain at the end of each interval times its speed."""
        drawn = self.by_rows(motion, state)
        return TwistError(drawn.f(motion, slice(None)), drawn.state)

    def by_rows(self, motion: Motion, state: State) -> ByRows:
        """Return f by single intervals: the gain does not depend on the motion."""
        rng = copied(state.rng)
        keep = np.exp(-motion.dt_s / self.tau)
        normal = autoregression(state.normal, keep, np.sqrt(1.0 - keep**2) * rng.standard_normal(len(motion)))
        last = float(normal[-1]) if len(normal) else state.normal
        gain = np.clip(self.sigma * normal, -_MOST, _MOST)
        return ByRows(lambda rows, index: self._on_channel(gain[index] * self._speed(rows)), _Gain(rng, last))

    def moments(self, motion: Motion) -> Moments:
        """Return the stationary variance of the gain times the speed squared."""
        return Moments(np.zeros((len(motion), 3)), self._on_channel((self.sigma * self._speed(motion)) ** 2))

    def gains(self, motion: Motion) -> tuple[RandomCoefficient, ...]:
        """Return the gain: it decays with tau, driven by noise that keeps its variance constant."""
        keep = np.exp(-motion.dt_s / self.tau)
        variance = self.sigma**2
        return (RandomCoefficient(self._on_channel(self._speed(motion)), keep, variance * (1.0 - keep**2), variance),)

    def _speed(self, motion: Motion) -> Array:
        return motion.omega if self.channel == "yaw" else motion.v

    def _on_channel(self, values: Array) -> Array:
        along, yaw = (values, 0.0) if self.channel == "along" else (0.0, values)
        return stacked(along, 0.0, yaw, values)

"""Gyro bias that varies as a random walk or a first-order Gauss-Markov process."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.effects.effect import (
    About,
    Effect,
    Moments,
    Motion,
    RandomCoefficient,
    State,
    TwistError,
    parameter,
    stacked,
)
from odomcorrupt.effects.random_state import autoregression, copied

if TYPE_CHECKING:
    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array


class _Walk(NamedTuple):
    rng: Generator
    bias: float


@dataclass(frozen=True, slots=True)
class GyroBiasWalk(Effect):
    """f = (0, 0, -bias), the bias a random walk from zero: variance density^2 t, also at rest.

    With a time constant tau it reverts to zero, b' = -b / tau + white noise, with deviation density sqrt(tau / 2).
    """

    name = "gyro_bias_walk"
    kind = "noise"
    summary = "the yaw rate's offset varies slowly, also at rest"
    needs_gyro = True
    shown_at_rest = True
    about = About(
        equation="f_yaw = -b(t), b a random walk with standard deviation density sqrt(t); with tau Gauss-Markov of "
        "deviation density sqrt(tau / 2)",
        typical="1e-3 to 3e-2 deg/s per sqrt(s), which is 2e-5 to 5e-4 rad/s per sqrt(s); tau of minutes to hours "
        "for a gyro, of seconds where a steered wheel or a castor has play",
        source="Woodman 2007, An introduction to inertial navigation (bias instability as a random walk); "
        "IEEE Std 952-1997, annex C (exponentially correlated noise)",
        confused_with=("gyro_bias", "gauss_markov"),
        drive="stand still for a minute, more than once",
    )

    density: float = parameter("rad/s/sqrt(s)", "standard deviation after one second", low=0.0, high=0.05, typical=2e-4)
    tau: float = parameter(
        "s", "time constant of its return to zero; 0: none", low=0.0, high=1e5, typical=10.0, amplitude=False
    )

    def start(self, rng: Generator) -> State:
        """Return an initial bias (zero for a random walk) and its random generator."""
        if not self.tau:
            return _Walk(rng, 0.0)
        rng = copied(rng)
        return _Walk(rng, self._spread * float(rng.standard_normal()))

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f, with the bias at the end of each interval."""
        rng = copied(state.rng)
        keep, kick = self.kept(motion.dt_s)
        kicks = np.sqrt(kick) * rng.standard_normal(len(motion))
        bias = autoregression(state.bias, keep, kicks)
        last = float(bias[-1]) if len(bias) else state.bias
        return TwistError(stacked(0.0, 0.0, -bias, motion.v), _Walk(rng, last))

    def moments(self, motion: Motion) -> Moments:
        """Return the growing variance of the random walk, or the stationary one."""
        nothing = np.zeros_like(motion.v)
        variance = nothing + self._spread**2 if self.tau else self.density**2 * np.cumsum(motion.dt_s)
        return Moments(np.zeros((len(motion), 3)), stacked(nothing, nothing, variance, nothing))

    def gains(self, motion: Motion) -> tuple[RandomCoefficient, ...]:
        """Return the bias as an autoregressive coefficient."""
        one = np.ones_like(motion.v)
        return (RandomCoefficient(stacked(0.0, 0.0, -one, one), *self.kept(motion.dt_s), self._spread**2),)

    @property
    def _spread(self) -> float:
        """Standard deviation of the bias at the start, rad/s."""
        return float(self.density * np.sqrt(0.5 * self.tau))

    def kept(self, dt_s: Array) -> tuple[Array, Array]:
        """Return the factor (n,) by which the bias decays over each interval, and the variance of the noise added."""
        if not self.tau:
            return np.ones_like(dt_s), self.density**2 * dt_s
        keep = np.exp(-dt_s / self.tau)
        return keep, self._spread**2 * (1.0 - keep**2)

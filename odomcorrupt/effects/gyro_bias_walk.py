"""The gyro's bias wanders."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, NamedTuple

import numpy as np

from odomcorrupt.effects.draws import again
from odomcorrupt.effects.effect import (
    About,
    Effect,
    Gain,
    Kind,
    Moments,
    Motion,
    State,
    TwistError,
    parameter,
    stacked,
)

if TYPE_CHECKING:
    from numpy.random import Generator


class _Walk(NamedTuple):
    rng: Generator
    bias: float


@dataclass(frozen=True, slots=True)
class GyroBiasWalk(Effect):
    """f = (0, 0, -bias), the bias a random walk from zero: variance density^2 t. It goes on while standing."""

    name: ClassVar[str] = "gyro_bias_walk"
    kind: ClassVar[Kind] = "noise"
    summary: ClassVar[str] = "the yaw rate's offset wanders, also while standing"
    about: ClassVar[About | None] = About(
        equation="f_yaw = -b(t), b a random walk with standard deviation density sqrt(t)",
        typical="1e-3 to 3e-2 deg/s per sqrt(s), which is 2e-5 to 5e-4 rad/s per sqrt(s)",
        source="Woodman 2007, An introduction to inertial navigation (bias instability as a random walk)",
        confused_with=("gyro_bias", "gauss_markov"),
        drive="stand still for a minute, more than once",
    )

    density: float = parameter("rad/s/sqrt(s)", "standard deviation after one second", low=0.0, high=0.05, typical=2e-4)

    def start(self, rng: Generator) -> State:
        """Return a bias of zero and what it will be drawn from."""
        return _Walk(rng, 0.0)

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the bias as it is at the end of each interval."""
        rng = again(state.rng)
        kick = self.density * np.sqrt(motion.dt_s) * rng.standard_normal(len(motion))
        bias = np.cumsum(np.concatenate(([state.bias], kick)))
        return TwistError(stacked(0.0, 0.0, -bias[1:], motion.v), _Walk(rng, float(bias[-1])))

    def moments(self, motion: Motion) -> Moments:
        """Return the walk's growing variance."""
        nothing = np.zeros_like(motion.v)
        variance = self.density**2 * np.cumsum(motion.dt_s)
        return Moments(np.zeros((len(motion), 3)), stacked(nothing, nothing, variance, nothing))

    def gains(self, motion: Motion) -> tuple[Gain, ...]:
        """Return the bias: nothing at first, it forgets nothing."""
        one = np.ones_like(motion.v)
        return (Gain(stacked(0.0, 0.0, -one, one), one, self.density**2 * motion.dt_s, 0.0),)

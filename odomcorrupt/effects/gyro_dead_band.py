"""Dead band of a gyro: small yaw rates read exactly zero."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import (
    About,
    Effect,
    Moments,
    Motion,
    RandomCoefficient,
    Recorded,
    State,
    TwistError,
    parameter,
    stacked,
)
from odomcorrupt.effects.random_state import copied

if TYPE_CHECKING:
    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array


@dataclass(frozen=True, slots=True)
class GyroDeadBand(Effect):
    """Yaw rates whose measured absolute value is below `threshold` are reported as zero; a turn that slow is lost.

    The gyro's noise decides which rates near the threshold are reported, so the effect counts as noise. What is lost is
    not a function of the reported motion and cannot be undone: f = 0 for correction and study. The study detects the
    band in the odometry.
    """

    name = "gyro_dead_band"
    kind = "noise"
    layer = "record"
    needs_gyro = True
    summary = "yaw rates below a threshold read exactly zero, so that slow turns are lost"
    about = About(
        equation="reported yaw rate = 0 where abs(yaw rate + noise) < threshold",
        typical="0.005 to 0.03 rad/s in drivers that suppress the drift of a robot at rest (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("complementary_filter", "gyro_bias_walk", "gyro_scale", "wheelbase"),
        drive="long slow bends to one side: the odometry reports a straight line",
    )

    threshold: float = parameter("rad/s", "yaw rate below which zero is reported", low=0.0, high=0.5, typical=0.015)
    noise: float = parameter(
        "rad/s", "standard deviation of the gyro's noise in a message", low=1e-6, high=0.1, typical=0.002,
        identity=0.002, amplitude=False,
    )  # fmt: skip

    def start(self, rng: Generator) -> State:
        """Return the random generator of the noise, and the last stamp."""
        return rng, 0.0

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f = 0: what is lost is not a function of the reported motion."""
        return TwistError(np.zeros((len(motion), 3)), state)

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - no wheels
        """Return the increments without turns within the band."""
        rng, last_s = copied(state[0]), state[1]
        dt = np.diff(t_s, prepend=last_s)
        rate = np.divide(steps[:, 2], dt, out=np.full_like(dt, np.inf), where=dt > 0.0)
        lost = np.abs(rate + self.noise * rng.standard_normal(len(steps))) < self.threshold
        reported = steps.copy()
        reported[lost, 2] = 0.0
        return Recorded(reported, (rng, float(t_s[-1]) if len(t_s) else last_s))

    def moments(self, motion: Motion) -> Moments:
        """Return mean and variance of the lost yaw rate."""
        p = self._lost(motion)
        turn = stacked(0.0, 0.0, motion.omega, motion.v)
        return Moments(p[:, None] * turn, (p * (1.0 - p))[:, None] * turn**2)

    def gains(self, motion: Motion) -> tuple[RandomCoefficient, ...]:
        """Return one independent coefficient per increment; the mean loss is not included."""
        p = self._lost(motion)
        turn = stacked(0.0, 0.0, motion.omega, motion.v)
        return (RandomCoefficient(turn * np.sqrt(p * (1.0 - p))[:, None], np.zeros_like(p), np.ones_like(p), 0.0),)

    def _lost(self, motion: Motion) -> Array:
        """Return the probability (n,) that a turn is lost."""
        above, below = ((side * self.threshold - motion.omega) / self.noise for side in (1.0, -1.0))
        return np.where(motion.dt_s > 0.0, _normal_cdf(above) - _normal_cdf(below), 0.0)


def _normal_cdf(z: Array) -> Array:
    """Return the cumulative standard normal distribution (n,), without SciPy, which corruption does not need."""
    return 0.5 * np.array([math.erfc(-one * math.sqrt(0.5)) for one in z])

"""Heading of a compass that iron on the robot deflects, after a low-pass filter."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple, Self

import numpy as np

from odomcorrupt.effects.effect import About, Effect, Motion, State, TwistError, parameter, stacked
from odomcorrupt.effects.random_state import autoregression

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.random import Generator

_TIMES_S = (0.0, 1.0, 3.0, 10.0)
"""Trial time constants, seconds: from a compass that is read directly to one that slowly corrects a gyro."""


class _Deflection(NamedTuple):
    """State: the heading's error so far, rad; None before the first interval."""

    rad: float | None = None


@dataclass(frozen=True, slots=True)
class HardIron(Effect):
    """f = (0, 0, -d'), the error d of the heading obeys tau d' + d = k cos(theta) + m sin(theta).

    theta is the true heading, tau the time constant of the filter, 0 for none. The robot has stood for a long time.
    """

    name = "hard_iron"
    odd = True
    summary = "a compass is deflected by iron on the robot: the heading's error is a wave over the heading"
    needs_gyro = True
    reads_truth = True
    reads_places = True
    about = About(
        equation="f_yaw = -d', tau d' + d = k cos(theta) + m sin(theta)",
        typical="1 to 10 degrees without calibration; tau 0 to 10 s, of a filter that takes fast turns from a gyro "
        "(an estimate)",
        source="Gebre-Egziabher, Elkaim, Powell & Parkinson 2006, Journal of Aerospace Engineering 19(2)",
        confused_with=("complementary_filter", "gyro_scale", "wheelbase"),
        drive="turn by 90 deg on the spot, and stand still for a minute, in all four headings",
    )

    # up to 20 degrees: the wave is the first order of a deflection, and one line of travel allows any amplitude
    k: float = parameter("rad", "error at heading zero of the truth", low=-0.35, high=0.35, typical=0.05)
    m: float = parameter("rad", "error at a heading of 90 degrees", low=-0.35, high=0.35, typical=0.05)
    time_constant: float = parameter(
        "s", "time constant of the low-pass filter", low=0.0, high=100.0, typical=3.0, amplitude=False, optional=True
    )

    @classmethod
    def scan(cls, motions: Sequence[Motion]) -> tuple[Self, ...]:  # noqa: ARG003 - filters do not depend on the drive
        """Return a candidate for each trial time constant."""
        return tuple(cls(time_constant=tau) for tau in _TIMES_S)

    def start(self, rng: Generator) -> State:  # noqa: ARG002 - nothing is drawn
        """Return the state of a robot that has stood for a long time."""
        return _Deflection()

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f, from the true headings where the intervals begin, which do not depend on what is reported."""
        if not len(motion):
            return TwistError(np.zeros((0, 3)), state)
        dt_s = motion.dt_s
        towards = self.k * np.cos(motion.theta) + self.m * np.sin(motion.theta)
        first = float(towards[0]) if state.rad is None else state.rad
        kept = np.divide(self.time_constant, self.time_constant + dt_s, out=np.ones_like(dt_s), where=dt_s > 0.0)
        error = autoregression(first, kept, (1.0 - kept) * towards)
        change = np.diff(error, prepend=first)
        rate = np.divide(change, dt_s, out=np.zeros_like(dt_s), where=dt_s > 0.0)
        return TwistError(stacked(0.0, 0.0, -rate, motion.v), _Deflection(float(error[-1])))

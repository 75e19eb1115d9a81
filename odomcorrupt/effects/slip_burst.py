"""Short bursts of slip of one wheel or both at random times."""

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
from odomcorrupt.effects.random_state import copied
from odomcorrupt.effects.wheels import Rims, body_of, heading_choice, rims_of, turning

if TYPE_CHECKING:
    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array

_BOTH, _SINGLE = ((1.0, 1.0),), ((1.0, 0.0), (0.0, 1.0))
"""Share of a burst's slip at the right wheel and at the left."""
_MOST = 0.75
"""Largest slip: a wheel that loses more is not distinguishable from one that spins on the spot."""


class _Burst(NamedTuple):
    begin_s: float
    slip: float
    right: float
    left: float


class _Bursts(NamedTuple):
    """Elapsed time, the current (or last) burst, and the next one."""

    rng: Generator
    clock_s: float
    now: _Burst
    next: _Burst


@dataclass(frozen=True, slots=True)
class SlipBurst(Effect):
    """f_wheel = -slip u during bursts, which begin at random with `rate` per second and last `duration`.

    A burst affects the right wheel, the left or both alike, with equal probability; without a track, always both. Slips
    are uniformly distributed about their mean, within 0 to 0.75. A new burst ends the previous one.
    """

    name = "slip_burst"
    kind = "noise"
    summary = "now and then a wheel spins for a moment"
    about = About(
        equation="f_wheel = -slip u for each wheel's rim speed u during bursts, 0 between them",
        typical="30 % and more for 0.1 to 0.5 s, a few times a minute on a bad floor (an estimate)",
        source="engineering judgement; no published figures known to us",
        confused_with=("heavy_tails", "region_slip", "gauss_markov", "wheel_scale"),
        drive="cross the same floor again: slip of a patch recurs, a burst does not",
    )

    rate: float = parameter("1/s", "how many begin per second", low=0.0, high=5.0, typical=0.05)
    slip: float = parameter(
        "",
        "mean part of the wheel's travel that is lost",
        low=0.0,
        high=_MOST,
        typical=0.4,
        identity=0.4,
        amplitude=False,
    )
    duration: float = parameter(
        "s", "how long one lasts", low=0.01, high=10.0, typical=0.3, identity=0.3, amplitude=False
    )
    heading: str = heading_choice()
    sides: str = choice("which wheels slip: one or both by chance, or always both, which does not turn", "any", "both")

    def start(self, rng: Generator) -> State:
        """Return zero elapsed time, no current burst, and the first burst."""
        rng = copied(rng)
        return _Bursts(rng, 0.0, _Burst(-np.inf, 0.0, 0.0, 0.0), self._draw(rng, 0.0))

    def _spread(self) -> float:
        return min(self.slip, _MOST - self.slip)

    def _draw(self, rng: Generator, after_s: float) -> _Burst:
        # three draws per burst whatever the parameters, so that similar parameters give similar runs
        gap, place, side = float(rng.standard_exponential()), float(rng.uniform(-1.0, 1.0)), int(rng.integers(3))
        begin = after_s + gap / self.rate if self.rate > 0.0 else np.inf
        both = self.sides == "both"
        return _Burst(begin, self.slip + place * self._spread(), float(both or side != 1), float(both or side != 2))

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f: the slip over the fraction of each interval that lies in a burst."""
        drawn = self.by_rows(motion, state)
        return TwistError(drawn.f(motion, slice(None)), drawn.state)

    def by_rows(self, motion: Motion, state: State) -> ByRows:
        """Return f by single intervals: when bursts come does not depend on the motion."""
        rng, now, coming = copied(state.rng), state.now, state.next
        clock = np.cumsum(np.concatenate(([state.clock_s], motion.dt_s)))
        right, left = np.zeros(len(motion)), np.zeros(len(motion))
        while True:
            end_s = min(now.begin_s + self.duration, coming.begin_s)
            first = max(int(np.searchsorted(clock, now.begin_s, side="right")) - 1, 0)
            last = int(np.searchsorted(clock, end_s))
            if first < last:
                inside = (
                    np.minimum(clock[first + 1 : last + 1], end_s)
                    - np.maximum(clock[first:last], now.begin_s)[: len(clock) - 1 - first]
                )
                lost = now.slip * np.maximum(inside, 0.0)
                right[first:last] += now.right * lost
                left[first:last] += now.left * lost
            if coming.begin_s > clock[-1]:
                break
            now, coming = coming, self._draw(rng, coming.begin_s)
        dt = motion.dt_s
        share = [np.divide(x, dt, out=np.zeros_like(x), where=dt > 0.0) for x in (right, left)]
        after = _Bursts(rng, float(clock[-1]), now, coming)
        return ByRows(lambda rows, index: self._lost(rows, Rims(*(x[index] for x in share))), after)

    def _lost(self, motion: Motion, share: Rims) -> Array:
        if motion.track_m is None:
            both = -np.maximum(share.right, share.left)
            return stacked(both * motion.v, both * motion.vy, turning(self.heading, both * motion.omega), motion.v)
        u = rims_of(motion.v, motion.omega, motion.track_m)
        f = body_of(Rims(-share.right * u.right, -share.left * u.left), motion.track_m, self.heading)
        f[:, 1] = -0.5 * (share.right + share.left) * motion.vy
        return f

    def moments(self, motion: Motion) -> Moments:
        """Return the mean loss by bursts, and variances that hold for intervals much shorter than a burst."""
        gone = np.cumsum(motion.dt_s) - motion.dt_s / 2.0
        on = 1.0 - np.exp(-self.rate * np.minimum(gone, self.duration))
        square = self.slip**2 + self._spread() ** 2 / 3.0
        one = np.ones(len(motion))
        wheels = _BOTH if self.sides == "both" else (*_BOTH, *_SINGLE)
        sides = [self._lost(motion, Rims(r * one, f * one)) for r, f in wheels]
        mean = on[:, None] * self.slip * np.mean(sides, axis=0)
        return Moments(mean, on[:, None] * square * np.mean(np.square(sides), axis=0) - mean**2)

    def gains(self, motion: Motion) -> tuple[RandomCoefficient, ...]:
        """Return the common and the differential error of the wheels as autoregressive coefficients.

        A wheel that loses the fraction s of its travel reports 1 / (1 - s) of the true travel, s uniformly distributed.
        The slip is constant within a burst: its autocorrelation is a triangle as long as a burst, with the same
        integral as exp(-t / tau) for tau half of that length.
        """
        on = 1.0 - np.exp(-self.rate * self.duration)
        lasts_s = on / self.rate if self.rate > 0.0 else self.duration
        keep = np.exp(-2.0 * motion.dt_s / lasts_s)
        low, high = self.slip - self._spread(), self.slip + self._spread()
        longer = np.log((1.0 - low) / (1.0 - high)) / (high - low) if high > low else 1.0 / (1.0 - low)
        mean, square = on * (longer - 1.0), on * (1.0 / ((1.0 - low) * (1.0 - high)) - 2.0 * longer + 1.0)
        one = np.ones(len(motion))
        if motion.track_m is None or self.sides == "both":
            return (_stationary(self._lost(motion, Rims(one, one)), keep, square - mean**2),)
        # right, left, or both, equally likely: half of sum and difference have these squares and are uncorrelated
        alike = square / 2.0 - (mean * 2.0 / 3.0) ** 2
        both, right, left = (self._lost(motion, Rims(r * one, f * one)) for r, f in (*_BOTH, *_SINGLE))
        return _stationary(both, keep, alike), _stationary(right - left, keep, square / 6.0)


def _stationary(f: Array, keep: Array, variance: float) -> RandomCoefficient:
    return RandomCoefficient(f, keep, variance * (1.0 - keep**2), variance)

"""Effects that are random: bursts of slip, walks of a bias, varying gains, heavy tails."""

from __future__ import annotations

import copy
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.effects.effect import (
    About,
    ByRows,
    Drawn,
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
from odomcorrupt.effects.wheels import Rims, body_of, heading_choice, rims_of, scaled

if TYPE_CHECKING:
    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array


def copied(rng: np.random.Generator) -> np.random.Generator:
    """Return a copy of a generator, so that a state can be continued more than once."""
    return copy.deepcopy(rng)


def autoregression(start: float, keep: Array, kick: Array) -> Array:
    """Return x (n,) with x_i = keep_i x_(i-1) + kick_i, computed sequentially so that splitting gives the same bits.

    start : x before the first one
    keep, kick : (n,) factors and additions
    """
    x = start
    return np.array([x := kept * x + kicked for kept, kicked in zip(keep.tolist(), kick.tolist(), strict=True)])


_MOST = 0.9
"""Limit of the gain: beyond 1 the robot would stand or reverse while its wheels roll forwards."""


class _Process(NamedTuple):
    rng: Generator
    value: float


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
        return _Process(rng, float(rng.standard_normal()))

    def by_rows(self, motion: Motion, state: State) -> ByRows:
        """Return f, the gain at the end of each interval times its speed; the gain does not depend on the motion."""
        rng = copied(state.rng)
        keep = np.exp(-motion.dt_s / self.tau)
        normal = autoregression(state.value, keep, np.sqrt(1.0 - keep**2) * rng.standard_normal(len(motion)))
        last = float(normal[-1]) if len(normal) else state.value
        gain = np.clip(self.sigma * normal, -_MOST, _MOST)
        return ByRows(lambda rows, index: self._on_channel(gain[index] * self._speed(rows)), _Process(rng, last))

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
            return _Process(rng, 0.0)
        rng = copied(rng)
        return _Process(rng, self._spread * float(rng.standard_normal()))

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f, with the bias at the end of each interval."""
        rng = copied(state.rng)
        keep, kick = self.kept(motion.dt_s)
        kicks = np.sqrt(kick) * rng.standard_normal(len(motion))
        bias = autoregression(state.value, keep, kicks)
        last = float(bias[-1]) if len(bias) else state.value
        return TwistError(stacked(0.0, 0.0, -bias, motion.v), _Process(rng, last))

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


@dataclass(frozen=True, slots=True)
class HeavyTails(Effect):
    """Student's t in place of the noise law's normal draws, scaled to the law's variance, so that covariances hold.

    t with nu degrees of freedom is a normal over sqrt(chi-square / nu); nu - 2 in place of nu gives variance 1.
    """

    name = "heavy_tails"
    kind = "noise"
    layer = "draws"
    summary = "the noise has heavy tails: rare steps are much larger than normal ones"
    about = About(
        equation="draws of the noise law ~ Student t with 1 / inverse_dof degrees of freedom and variance 1",
        typical="0.1 to 0.3, ten to three degrees of freedom (an estimate)",
        source="Lange, Little & Taylor 1989, JASA 84 (the t distribution for robust modelling)",
        confused_with=("slip_burst", "gauss_markov", "region_slip"),
        drive="none in particular: visible in single increments, since sums over many are nearly normal",
    )

    inverse_dof: float = parameter("", "one over the degrees of freedom; 0 is normal", low=0.0, high=0.45, typical=0.2)

    def start(self, rng: Generator) -> State:
        """Return the random generator of the widths."""
        return rng

    def drawn(self, normals: Array, state: State) -> Drawn:
        """Return t-distributed draws in place of the normals (n, 4), each with its own width."""
        if self.inverse_dof == 0.0:
            return Drawn(normals, state)
        rng = copied(state)
        dof = 1.0 / self.inverse_dof
        return Drawn(normals * np.sqrt((dof - 2.0) / rng.chisquare(dof, normals.shape)), rng)


_BOTH, _SINGLE = ((1.0, 1.0),), ((1.0, 0.0), (0.0, 1.0))
"""Share of a burst's slip at the right wheel and at the left."""
_MOST_SLIP = 0.75
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
        "", "mean part of the wheel's travel that is lost", low=0.0, high=_MOST_SLIP, typical=0.4, identity=0.4,
        amplitude=False,
    )  # fmt: skip
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
        return min(self.slip, _MOST_SLIP - self.slip)

    def _draw(self, rng: Generator, after_s: float) -> _Burst:
        # three draws per burst whatever the parameters, so that similar parameters give similar runs
        gap, place, side = float(rng.standard_exponential()), float(rng.uniform(-1.0, 1.0)), int(rng.integers(3))
        begin = after_s + gap / self.rate if self.rate > 0.0 else np.inf
        both = self.sides == "both"
        return _Burst(begin, self.slip + place * self._spread(), float(both or side != 1), float(both or side != 2))

    def by_rows(self, motion: Motion, state: State) -> ByRows:
        """Return f, the slip over the fraction of each interval that lies in a burst; the motion decides on none."""
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
            return stacked(*scaled(motion, -np.maximum(share.right, share.left), self.heading), motion.v)
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

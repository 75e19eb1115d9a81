"""Errors of a heading that is measured: by a gyro, a compass, or a filter of both."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.drive_types import PIVOTING
from odomcorrupt.effects.effect import (
    About,
    Effect,
    Moments,
    Motion,
    RandomCoefficient,
    Recorded,
    State,
    TwistError,
    gain,
    parameter,
    stacked,
)
from odomcorrupt.effects.random_processes import autoregression, copied

if TYPE_CHECKING:
    from numpy.random import Generator

    from odomcorrupt.geometry.se2 import Array


GyroBias = gain(
    "gyro_bias",
    "the yaw rate has a constant offset, also while standing",
    lambda it, _: (0.0, 0.0, -it.bias),
    About(
        equation="f_yaw = -bias",
        typical="0.01 to 0.1 deg/s after zeroing a MEMS gyro, 1 deg/s raw",
        source="Woodman 2007, An introduction to inertial navigation",
        confused_with=("unequal_wheels", "gyro_bias_walk", "turn_asymmetry"),
        drive="stand still for a minute",
    ),
    needs_gyro=True,
    bias=parameter("rad/s", "odometry yaw rate minus the true one", low=-0.5, high=0.5, typical=0.003),
)

GyroWarmUp = gain(
    "gyro_warm_up",
    "the yaw rate has an offset that settles while the gyro warms up",
    lambda it, m: (0.0, 0.0, it.bias * np.expm1(-m.t_s / it.settle)),
    About(
        equation="f_yaw = -bias (1 - exp(-t / settle)), t since the first odometry stamp",
        typical="0.01 to 0.5 deg/s, in one to ten minutes after switching on",
        source="Aggarwal, Syed, Niu & El-Sheimy 2008, J. Navigation 61 (bias over temperature); form: a judgement",
        confused_with=("gyro_bias_walk", "gyro_bias", "scale_drift"),
        drive="stand still for ten minutes after switching on, and once more when warm",
    ),
    needs_gyro=True,
    bias=parameter("rad/s", "odometry yaw rate minus the true one, when warm", low=-0.5, high=0.5, typical=0.003),
    settle=parameter("s", "time constant", low=10.0, high=3600.0, typical=200.0, identity=200.0, amplitude=False,
                     trials=(50.0, 150.0, 500.0)),
)  # fmt: skip

GyroScale = gain(
    "gyro_scale",
    "the yaw rate has a wrong gain",
    lambda it, m: (0.0, 0.0, -it.e / (1.0 + it.e) * m.omega),
    About(
        equation="f_yaw = -e / (1 + e) omega",
        typical="0.1 to 3 % for an uncalibrated MEMS gyro",
        source="Woodman 2007, An introduction to inertial navigation (calibration errors)",
        confused_with=("wheelbase", "turn_asymmetry"),
        drive="turn on the spot both ways; only the source of the heading separates the two",
    ),
    needs_gyro=True,
    aliased_with="wheelbase",
    e=parameter("", "odometry yaw rate over the true one, minus one", low=-0.9995, high=1999.0, typical=0.01),
)


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

    threshold: float = parameter("rad/s", "yaw rate below which zero is reported", low=0.0, high=3.0, typical=0.015)
    noise: float = parameter(
        "rad/s", "standard deviation of the gyro's noise in a message", low=1e-6, high=0.1, typical=0.002,
        identity=0.002, amplitude=False,
    )  # fmt: skip

    def start(self, rng: Generator) -> State:
        """Return the random generator of the noise, and the last stamp."""
        return rng, 0.0

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


@dataclass(frozen=True, slots=True)
class HardIron(Effect):
    """f = (0, 0, -d'), the error d of the heading obeys tau d' + d = k cos(theta) + m sin(theta).

    theta is the true heading, tau the time constant of the filter, 0 for none. The robot has stood for a long time.
    """

    name = "hard_iron"
    odd = True
    initial = (None,)  # the heading's error so far, rad
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
        "s", "time constant of the low-pass filter", low=0.0, high=100.0, typical=3.0, amplitude=False, optional=True,
        trials=(0.0, 1.0, 3.0, 10.0),
    )  # fmt: skip

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f, from the true headings where the intervals begin, which do not depend on what is reported."""
        if not len(motion):
            return TwistError(np.zeros((0, 3)), state)
        dt_s = motion.dt_s
        towards = self.k * np.cos(motion.theta) + self.m * np.sin(motion.theta)
        first = float(towards[0]) if state[0] is None else state[0]
        kept = np.divide(self.time_constant, self.time_constant + dt_s, out=np.ones_like(dt_s), where=dt_s > 0.0)
        error = autoregression(first, kept, (1.0 - kept) * towards)
        change = np.diff(error, prepend=first)
        rate = np.divide(change, dt_s, out=np.zeros_like(dt_s), where=dt_s > 0.0)
        return TwistError(stacked(0.0, 0.0, -rate, motion.v), (float(error[-1]),))


@dataclass(frozen=True, slots=True)
class ComplementaryFilter(Effect):
    """f = (0, 0, -e / (1 + e) L omega), L a low-pass filter of time constant tau / (1 + e).

    The reported heading follows the gyro at once, and the wheels' heading with time constant tau. Turns of the wheels'
    heading are (1 + e) times the true ones. The heading error d obeys tau d' + d = error of the wheels' heading.
    """

    name = "complementary_filter"
    layer = "record"
    initial = 0.0, 0.0  # low-pass filtered yaw rate of the odometry, rad/s, and last stamp, s
    summary = "a filter blends a gyro with a wheel heading of wrong gain: the error of a turn appears seconds later"
    needs_gyro = True
    drives = PIVOTING
    about = About(
        equation="f_yaw = -e / (1 + e) L omega, L a low-pass filter of time constant tau / (1 + e)",
        typical="e as in wheelbase, 0.5 to 5 %; tau 1 to 30 s (a shorter one is a lag of the wheels' heading)",
        source="Mahony, Hamel & Pflimlin 2008, IEEE T-AC 53(5), with one axis",
        confused_with=("wheelbase", "gyro_bias_walk", "channel_lag"),
        drive="turn by 180 deg on the spot, and stand still for a minute: the heading creeps at rest",
    )

    e: float = parameter("", "turn of the wheels divided by the true one, minus one", low=-0.5, high=1.0, typical=0.015)
    tau: float = parameter(
        "s", "time constant of the filter", low=1.0, high=100.0, typical=3.0, identity=3.0, amplitude=False,
        trials=(1.0, 3.0, 10.0, 30.0),
    )  # fmt: skip

    def twist_error(self, motion: Motion, state: State) -> TwistError:
        """Return f, from the filtered yaw rate (a backward Euler step for each interval)."""
        kept = self._time_s / (self._time_s + motion.dt_s)
        slow = autoregression(state[0], kept, (1.0 - kept) * motion.omega)
        last = float(slow[-1]) if len(slow) else state[0]
        return TwistError(stacked(0.0, 0.0, -self._gain * slow, motion.v), (last, state[1]))

    def recorded(self, steps: Array, t_s: Array, track_m: float | None, state: State) -> Recorded:  # noqa: ARG002 - no wheels
        """Return the increments (n, 3) with the turns that the filter reports; the inverse is `restored`."""
        reported = steps.copy()
        slow, last_s = state
        for i, (turn, now_s) in enumerate(zip(steps[:, 2].tolist(), t_s.tolist(), strict=True)):
            dt_s, last_s = now_s - last_s, now_s
            if not dt_s > 0.0:  # repeated stamp, or a reset of time
                slow = slow if dt_s == 0.0 else 0.0
                continue
            kept = self._time_s / (self._time_s + dt_s)
            rate = (turn / dt_s + self._gain * kept * slow) / (1.0 - self._gain * (1.0 - kept))
            slow = kept * slow + (1.0 - kept) * rate
            reported[i, 2] = rate * dt_s if self.e else turn
        return Recorded(reported, (slow, last_s))

    @property
    def _gain(self) -> float:
        return self.e / (1.0 + self.e)

    @property
    def _time_s(self) -> float:
        return self.tau / (1.0 + self.e)

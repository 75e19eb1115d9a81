"""Motion over the intervals of a trajectory: speeds, accelerations, and their correction by effects."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import Effect, Motion
from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.increments import Increments, accumulate, increments
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from odomcorrupt.geometry.se2 import Array

__all__ = [
    "SMOOTHING_S",
    "TRAIL_S",
    "LineFits",
    "SpeedMemory",
    "accelerations",
    "corrected_increments",
    "corrected_twist",
    "error_of",
    "followed",
    "motion_of",
    "slopes",
]

SMOOTHING_S = 0.2
"""Window of the study's smoothed speeds and accelerations: averages ticks, resolves stops."""

TRAIL_S = 0.05
"""Averaging time of speeds before differentiation, because stamps may be bunched and poses come in ticks."""

TOLERANCE = 1e-12
"""Largest change of an increment between two rounds at convergence of a correction, metres or radians."""

MAX_ROUNDS = 2000
"""Large, because if an effect switches on and off for seconds, each round advances only to the next switch."""

_NUDGE = 0.5
"""Step of the numerical derivative with respect to the acceleration, m/s^2 and rad/s^2."""

_BLOCK = 1024

_RUNAWAY = 1e6
"""Change of an increment, metres, at which the iteration counts as diverged."""


class LineFits:
    """Line fits to samples in windows around given times; sums that depend only on the times are precomputed.

    Running sums make the cost linear in the number of samples; stamps may be uneven. Sums restart every `_BLOCK`
    windows, because over an hour they would lose a thousandth of a speed. If a window has fewer than two samples, the
    nearest ones on both sides are used.

    Parameters
    ----------
    t_s : (n,) times of the samples, seconds
    at_s : (m,) centres of the windows, seconds
    width_s : width of the windows

    """

    def __init__(self, t_s: Array, at_s: Array, width_s: float) -> None:
        first = np.searchsorted(t_s, at_s - width_s / 2.0, side="left")
        last = np.searchsorted(t_s, at_s + width_s / 2.0, side="right")
        here = np.clip(np.searchsorted(t_s, at_s), 1, len(t_s) - 1)
        self._t_s, self._first, self._last = t_s, np.minimum(first, here - 1), np.maximum(last, here + 1)
        count = (self._last - self._first).astype(np.float64)
        self._middle, self._spread = np.empty(len(at_s)), np.empty(len(at_s))
        for rows, samples in self._blocks():
            t = self._since(samples)
            st, stt = self._sums(np.stack((t, t**2)), rows, samples)
            self._middle[rows] = st / count[rows]
            self._spread[rows] = np.maximum(stt - st**2 / count[rows], 1e-12)

    def slopes(self, values: Array) -> Array:
        """Return the time derivatives (m, c) of values (n, c): the slopes of the lines.

        They are exactly zero in windows of constant values, so that rounding of the sums does not look like motion.
        """
        of_each = np.ascontiguousarray(values.T)
        slope = np.empty((len(of_each), len(self._first)))
        for rows, samples in self._blocks():
            x = of_each[:, samples] - of_each[:, [samples.start]]
            own, with_time = np.split(self._sums(np.concatenate((x, x * self._since(samples))), rows, samples), 2)
            slope[:, rows] = with_time - own * self._middle[rows]
        slope /= self._spread
        changes = np.concatenate(([0], np.cumsum((of_each[:, 1:] != of_each[:, :-1]).any(axis=0))))
        slope[:, changes[self._first] == changes[self._last - 1]] = 0.0
        return slope.T

    def _blocks(self) -> Iterator[tuple[slice, slice]]:
        """Yield blocks of windows with the samples in them."""
        for begin in range(0, len(self._first), _BLOCK):
            rows = slice(begin, begin + _BLOCK)
            yield rows, slice(int(self._first[rows].min()), int(self._last[rows].max()))

    def _since(self, samples: slice) -> Array:
        """Return the times of samples since the first one, seconds."""
        since: Array = self._t_s[samples] - self._t_s[samples.start]
        return since

    def _sums(self, values: Array, rows: slice, samples: slice) -> Array:
        """Return the sums (c, windows) of values (c, samples) over each window of a block."""
        running = np.zeros((len(values), values.shape[1] + 1))
        np.cumsum(values, axis=1, out=running[:, 1:])
        summed: Array = running[:, self._last[rows] - samples.start] - running[:, self._first[rows] - samples.start]
        return summed


def slopes(t_s: Array, values: Array, at_s: Array, width_s: float) -> Array:
    """Return time derivatives (m, c) of values (n, c) at times at_s (m,): slopes of `LineFits`."""
    return LineFits(t_s, at_s, width_s).slopes(values)


@dataclass(frozen=True, slots=True)
class SpeedMemory:
    """The last `TRAIL_S` of a motion, from which the accelerations of the next intervals are computed.

    clock_s : (m,) elapsed time at the ends of intervals, seconds
    travel : (m, 3) cumulative travel forward (m), leftward (m) and turn (rad) at these times
    latest : (2, 3) acceleration and trail of the last interval
    """

    clock_s: Array
    travel: Array
    latest: Array


@dataclass(frozen=True, slots=True)
class Accelerations:
    """Accelerations, and the speeds consistent with them.

    rate : (n, 3) m/s^2 and rad/s^2
    trail : (n, 3) the speeds that change at this rate, at the middle of each interval, m/s and rad/s
    before : (n, 2, 3) rate and trail of the interval before each; zero before the first
    memory : state for the next intervals; None before any time has passed
    """

    rate: Array
    trail: Array
    before: Array
    memory: SpeedMemory | None


def accelerations(twist: Array, dt_s: Array, memory: SpeedMemory | None = None) -> Accelerations:
    """Return the accelerations over n intervals from twists (n, 3) and lengths dt_s (n,), seconds.

    Rate of change of the mean speed over the last `TRAIL_S`, from an interval's start to its end. It is causal (with a
    mean delay of `TRAIL_S` / 2), any division of a motion gives the same bits, and its integral over a run is the
    change of speed, at any rate and jitter of stamps. The twist before the first interval is assumed equal to it.
    """
    n = len(dt_s)
    rate = np.zeros((n, 3))
    first = 0
    if memory is None:
        first = int(np.argmax(dt_s > 0.0)) if n else 0
        if not n or dt_s[first] <= 0.0:
            return Accelerations(rate, np.zeros((n, 3)), np.zeros((n, 2, 3)), None)
        before = 2.0 * TRAIL_S
        way = np.stack((-before * twist[first], np.zeros(3)))
        memory = SpeedMemory(np.array([-before, 0.0]), way, np.zeros((2, 3)))
    clock = np.cumsum(np.concatenate((memory.clock_s[-1:], dt_s)))
    travel = np.cumsum(np.concatenate((memory.travel[-1:], twist * dt_s[:, None])), axis=0)
    clock_s = np.concatenate((memory.clock_s, clock[1:]))
    way = np.concatenate((memory.travel, travel[1:]))
    earlier = np.stack([np.interp(clock - TRAIL_S, clock_s, way[:, i]) for i in range(3)], axis=1)
    speed = (travel - earlier) / TRAIL_S
    np.divide(np.diff(speed, axis=0), dt_s[:, None], out=rate, where=(dt_s > 0.0)[:, None])
    kept = max(int(np.searchsorted(clock_s, clock[-1] - TRAIL_S, side="right")) - 1, 0)
    trail = (speed[1:] + speed[:-1]) / 2.0
    trail[:first] = 0.0
    both = np.concatenate((memory.latest[None], np.stack((rate, trail), axis=1)))
    return Accelerations(rate, trail, both[:-1], SpeedMemory(clock_s[kept:].copy(), way[kept:].copy(), both[-1].copy()))


def motion_of(t_s: Array, xyt: Array, *, track_m: float | None = None) -> Motion:
    """Return the motion over the n - 1 intervals between poses xyt (n, 3) at times t_s (n,), seconds.

    Speeds are the mean speeds of the intervals, so that adding f to them and composing the poses is exact. They match
    smooth accelerations, too, which may replace those given.
    """
    steps = increments(xyt)
    dt = np.diff(t_s)
    rate = np.divide(1.0, dt, out=np.zeros_like(dt), where=dt > 0.0)
    twist = np.stack((steps.ds_m, steps.dl_m, steps.dtheta_rad), axis=1) * rate[:, None]
    travel = np.hypot(steps.ds_m, steps.dl_m)
    faster = accelerations(twist, dt)
    return Motion(
        t_s=t_s[1:],
        dt_s=dt,
        v=twist[:, 0],
        vy=twist[:, 1],
        omega=twist[:, 2],
        acceleration=faster.rate,
        x=xyt[:-1, 0],
        y=xyt[:-1, 1],
        theta=xyt[:-1, 2],
        distance=np.cumsum(travel),
        track_m=track_m,
    )


def error_of(effect: Effect, motion: Motion) -> Array:
    """Return an effect's twist error f (n, 3), m/s and rad/s, over a whole motion from its initial state."""
    # Seeding a stream takes longer than most effects; effects without state do not need it.
    state = effect.start(stream(0, 0, effect.name)) if type(effect).start is not Effect.start else None
    return effect.twist_error(motion, state).f


def corrected_increments(effects: Sequence[Effect], motion: Motion, place_xyt: Array | None = None) -> Increments:
    """Return the true increments from the odometry's motion, as of `corrected_twist`."""
    twist = corrected_twist(effects, motion, place_xyt)
    return Increments(*np.ascontiguousarray((twist * motion.dt_s[:, None]).T))


def corrected_twist(effects: Sequence[Effect], motion: Motion, place_xyt: Array | None = None) -> Array:
    """Return the true twist u = u' + f(u'), (n, 3) in m/s and rad/s, from the odometry's motion u'.

    Encoder effects are inverted first, since the others are functions of the motion that encoders should have reported;
    effects of the tracked point come last. Acceleration, pose and distance are the true ones, found by fixed-point
    iteration together with the twist. The draws of random effects are unknown and contribute nothing, except where
    the odometry itself shows them; clock effects are not corrected.

    Parameters
    ----------
    effects : any order
    motion : from `motion_of`
    place_xyt : (n, 3)
        True poses at the starts of the intervals, where known; otherwise the corrected poses, from the odometry's
        start.

    Raises
    ------
    EffectError
        If no true motion explains the odometry: an effect of accelerations that counteracts them.

    """
    systematic = [e for e in effects if e.kind != "noise" and not e.clock]
    shown = [e for e in effects if e.layer == "record" and (e.kind != "noise" or e.restorable)]
    for effect in sorted(shown, key=lambda e: e.name, reverse=True):  # the last to act is the first to be undone
        motion = effect.restored(motion)
    twist = np.stack((motion.v, motion.vy, motion.omega), axis=1)
    moving = [e for e in systematic if e.layer == "motion"]
    robots = [e for e in moving if e.kind != "setup"]
    for effect in robots:
        if not effect.reads_truth:
            twist += error_of(effect, motion)
    seeking, setup = [e for e in robots if e.reads_truth], [e for e in moving if e.kind == "setup"]
    if seeking:
        twist = _settled(seeking, setup, motion, twist, place_xyt)
    return followed(setup, motion, twist)


def followed(setup: Sequence[Effect], motion: Motion, twist: Array) -> Array:
    """Return the twist (n, 3) of the tracked point (marker) on a robot with true twist (n, 3).

    The velocity of a marker off the axis follows the true turn, not the reported one, and a rotated mounting rotates
    that velocity as well. So these effects are applied one after the other, by name: lever arm, then mounting.
    """
    for effect in sorted(setup, key=lambda e: e.name):
        v, vy, omega = np.ascontiguousarray(twist.T)
        twist = twist + error_of(effect, replace(motion, v=v, vy=vy, omega=omega))
    return twist


def _settled(
    effects: Sequence[Effect], setup: Sequence[Effect], motion: Motion, known: Array, place_xyt: Array | None
) -> Array:
    """Return the true twist (n, 3): `known` plus the f of effects that depend on the true motion.

    They depend on earlier intervals and, within an interval, on its own acceleration only: dividing by the derivative
    with respect to that (Jacobi's method on a triangular system) makes the iteration converge for slip of any
    strength. Discontinuous effects use the interval before, so that a solution always exists.
    """
    dt = motion.dt_s[:, None]
    start = np.array([motion.x[0], motion.y[0], motion.theta[0]]) if len(motion) else np.zeros(3)
    stiff = np.ones((len(known), 1))
    truth = known
    for number in range(MAX_ROUNDS):
        shown = followed(setup, motion, truth)
        steps = shown * dt
        path = accumulate(start, Increments(*np.ascontiguousarray(steps.T)))[:-1] if place_xyt is None else place_xyt
        faster = accelerations(shown, motion.dt_s)
        seen = replace(
            motion,
            acceleration=faster.rate,
            trail=faster.trail,
            before=faster.before,
            x=np.ascontiguousarray(path[:, 0]),
            y=np.ascontiguousarray(path[:, 1]),
            theta=np.ascontiguousarray(path[:, 2]),
            distance=np.cumsum(np.hypot(steps[:, 0], steps[:, 1])),
        )
        with np.errstate(over="ignore", invalid="ignore"):  # divergence is reported below
            if number & (number - 1) == 0:  # at powers of two: less often as the estimate of the truth improves
                # never decreased: too large a stiffness converges late, too small a one never
                stiff = np.maximum(stiff, _stiffness(effects, seen))
            change = (known + _sum_of(effects, seen) - truth) / stiff
            truth = truth + change
        largest = np.abs(change * dt).max(initial=0.0)
        if largest <= TOLERANCE:
            return truth
        if not largest < _RUNAWAY:
            break
    names = ", ".join(effect.name for effect in effects)
    raise EffectError(
        f"effects ({names}): cannot be taken out of this odometry, u = u' + f(u) does not settle; make them "
        "weaker, or delete them from the model"
    )


def _stiffness(effects: Sequence[Effect], motion: Motion) -> Array:
    """Return upper bounds (n, 1) of the Jacobian's diagonal; 1 if f does not depend on the acceleration.

    A one-sided dependence, such as slip under braking only, counts with that side. Coupling between two channels adds
    its geometric mean, so that the slip of a single wheel counts in full. All channels share one number.
    """
    here = _sum_of(effects, motion)
    own, across = np.zeros_like(here), np.zeros((len(motion), 3, 3))
    for i in range(3):
        for nudge in (-_NUDGE, _NUDGE):
            aside = motion.acceleration.copy()
            aside[:, i] += nudge
            gain = (_sum_of(effects, replace(motion, acceleration=aside)) - here) / nudge
            own[:, i] = np.minimum(own[:, i], gain[:, i])
            across[:, i] = np.maximum(across[:, i], np.abs(gain))
    each_other = np.sqrt(across * across.transpose(0, 2, 1)) * (1.0 - np.eye(3))
    acting = (each_other.sum(axis=2) - own).max(axis=1, keepdims=True)
    stiff: Array = 1.0 + acting / np.maximum(motion.dt_s, TRAIL_S)[:, None]
    return stiff


def _sum_of(effects: Sequence[Effect], motion: Motion) -> Array:
    """Return the sum of the effects' f (n, 3)."""
    return sum((error_of(effect, motion) for effect in effects), start=np.zeros((len(motion), 3)))

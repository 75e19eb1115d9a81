"""Twist errors f of effects over a motion, and the true motion u = u' + f(u') after compensating for them."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import Effect, Motion
from odomcorrupt.errors import EffectError
from odomcorrupt.geometry.motion import SMOOTHING_S, TRAIL_S, LocalSlopes, accelerations
from odomcorrupt.geometry.se2 import Increments, accumulate
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.geometry.se2 import Array

TOLERANCE = 1e-12
"""Largest change of an increment between two rounds at convergence of a correction, metres or radians."""
MAX_ROUNDS = 2000
"""Large, because if an effect switches on and off for seconds, each round advances only to the next switch."""
_NUDGE = 0.5
"""Step of the numerical derivative with respect to the acceleration, m/s^2 and rad/s^2."""


def error_of(effect: Effect, motion: Motion) -> Array:
    """Return an effect's twist error f (n, 3), m/s and rad/s, over a whole motion from its initial state."""
    # Seeding a stream takes longer than most effects; effects without state do not need it.
    state = effect.start(stream(0, 0, effect.name)) if type(effect).start is not Effect.start else effect.initial
    return effect.twist_error(motion, state).f


def corrected_increments(
    effects: Sequence[Effect], motion: Motion, place_xyt: Array | None = None, *, rough: bool = False
) -> Increments:
    """Return the true increments, m and rad, from the odometry's motion; parameters are those of `corrected_twist`."""
    twist = corrected_twist(effects, motion, place_xyt, rough=rough)
    return Increments.of_rows(twist * motion.dt_s[:, None])


def corrected_twist(
    effects: Sequence[Effect], motion: Motion, place_xyt: Array | None = None, *, rough: bool = False
) -> Array:
    """Return the true twist u = u' + f(u'), (n, 3) in m/s and rad/s, from the odometry's motion u'.

    Encoder effects are inverted first, since the others are functions of the motion that encoders should have reported;
    effects of the tracked point come last. Acceleration, pose and distance are the true ones, found by fixed-point
    iteration together with the twist, which inverts corruption exactly. On rough odometry, effects that rectify noise
    take their accelerations from smoothed poses, first the odometry's and then the corrected ones, as in the study. The
    draws of random effects are unknown and contribute nothing, except where the odometry itself shows them; clock
    effects are not corrected.

    effects : any order
    motion : from `motion_of`
    place_xyt : (n, 3) true poses at the starts of the intervals, where known; otherwise the corrected poses, from the
        odometry's start
    rough : whether the odometry is rough, see `is_rough`

    Raises
    ------
    EffectError
        If no true motion explains the odometry: an effect of accelerations that counteracts them.
    """
    systematic = [e for e in effects if e.kind != "noise" and not e.clock]
    shown = [e for e in effects if e.layer == "record" and (e.kind != "noise" or e.restorable)]
    for effect in sorted(shown, key=lambda e: e.name, reverse=True):  # the last to act is the first to be undone
        motion = effect.restored(motion)
    twist = motion.twist
    moving = [e for e in systematic if e.layer == "motion"]
    robots = [e for e in moving if e.kind != "setup"]
    for effect in robots:
        if not effect.reads_truth:
            twist += error_of(effect, motion)
    seeking, setup = [e for e in robots if e.reads_truth], [e for e in moving if e.kind == "setup"]
    rectifying = [e for e in seeking if rough and e.rectifies]
    exact = [e for e in seeking if e not in rectifying]
    truth = motion.twist
    for _ in range(2 if rectifying else 1):
        known = twist
        if rectifying:
            known = twist + _sum_of(rectifying, _seen(motion, truth, place_xyt, smooth=True))
        truth = followed(setup, motion, _settled(exact, setup, motion, known, place_xyt) if exact else known)
    return truth


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
    stiff = np.ones((len(known), 1))
    truth = known
    for number in range(MAX_ROUNDS):
        seen = _seen(motion, followed(setup, motion, truth), place_xyt)
        with np.errstate(over="ignore", invalid="ignore"):  # divergence is reported below
            if number & (number - 1) == 0:  # at powers of two: less often as the estimate of the truth improves
                # never decreased: too large a stiffness converges late, too small a one never
                stiff = np.maximum(stiff, _stiffness(effects, seen))
            change = (known + _sum_of(effects, seen) - truth) / stiff
            truth = truth + change
        largest = np.abs(change * dt).max(initial=0.0)
        if largest <= TOLERANCE:
            return truth
        # change of an increment, metres, at which the iteration counts as diverged
        if not largest < 1e6:
            break
    names = ", ".join(effect.name for effect in effects)
    raise EffectError(
        f"effects ({names}): cannot be taken out of this odometry, u = u' + f(u) does not settle; make them "
        "weaker, or delete them from the model"
    )


def _seen(motion: Motion, twist: Array, place_xyt: Array | None, *, smooth: bool = False) -> Motion:
    """Return the odometry's motion with the accelerations, smooth or not, places and distance of a twist (n, 3)."""
    steps = twist * motion.dt_s[:, None]
    start = np.array([motion.x[0], motion.y[0], motion.theta[0]]) if len(motion) else np.zeros(3)
    path = accumulate(start, Increments.of_rows(steps))
    if smooth:
        ends_s = np.concatenate(([0.0], np.cumsum(motion.dt_s)))
        slopes = LocalSlopes(ends_s, (ends_s[:-1] + ends_s[1:]) / 2.0, SMOOTHING_S)
        smoothed = slopes.twist(path, path[:-1, 2] + steps[:, 2] / 2.0)
        motion = replace(motion, acceleration=slopes.accelerations(smoothed))
    else:
        faster = accelerations(twist, motion.dt_s)
        motion = replace(motion, acceleration=faster.rate, trail=faster.trail, before=faster.before)
    x, y, theta = np.ascontiguousarray((path[:-1] if place_xyt is None else place_xyt).T)
    return replace(motion, x=x, y=y, theta=theta, distance=np.cumsum(np.hypot(steps[:, 0], steps[:, 1])))


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
    return 1.0 + acting / np.maximum(motion.dt_s, TRAIL_S)[:, None]


def _sum_of(effects: Sequence[Effect], motion: Motion) -> Array:
    """Return the sum of the effects' f (n, 3)."""
    return sum((error_of(effect, motion) for effect in effects), start=np.zeros((len(motion), 3)))

"""Motion as effects see it: speeds and accelerations of a trajectory's intervals."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.effects.effect import Motion
from odomcorrupt.increments import Increments, increments
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from collections.abc import Iterable

    from odomcorrupt.effects.effect import Effect
    from odomcorrupt.pose import Array

__all__ = ["SMOOTHING_S", "corrected_increments", "motion_of", "slopes", "twist_error"]

SMOOTHING_S = 0.2
"""Width of the window over which speeds are differentiated: long enough to average ticks, short enough for stops."""


def slopes(t_s: Array, values: Array, at_s: Array, width_s: float) -> Array:
    """Return time derivatives (m, c) of values (n, c) at times at_s (m,): slopes of straight lines through +- width/2.

    Running sums make it linear in n whatever the rate, and it takes uneven stamps. Where a window holds fewer than
    two samples, the nearest ones on both sides are taken.
    """
    first = np.searchsorted(t_s, at_s - width_s / 2.0, side="left")
    last = np.searchsorted(t_s, at_s + width_s / 2.0, side="right")
    here = np.clip(np.searchsorted(t_s, at_s), 1, len(t_s) - 1)
    first, last = np.minimum(first, here - 1), np.maximum(last, here + 1)
    count = (last - first).astype(np.float64)
    centred = t_s - t_s.mean()
    origin = values.mean(axis=0)

    def window_sum(x: Array) -> Array:
        total = np.concatenate((np.zeros((1, *x.shape[1:])), np.cumsum(x, axis=0)))
        summed: Array = total[last] - total[first]
        return summed

    st, stt = window_sum(centred), window_sum(centred**2)
    sv, stv = window_sum(values - origin), window_sum((values - origin) * centred[:, None])
    spread = np.maximum(stt - st**2 / count, 1e-12)
    slope: Array = (stv - sv * (st / count)[:, None]) / spread[:, None]
    return slope


def motion_of(t_s: Array, xyt: Array, *, track_m: float | None = None) -> Motion:
    """Return the motion over the n - 1 intervals between poses (n, 3) at t_s (n,) seconds.

    Speeds are those of the intervals themselves, so that adding f to them and composing again is exact;
    accelerations are slopes of the speeds over `SMOOTHING_S`.
    """
    steps = increments(xyt)
    dt = np.diff(t_s)
    rate = np.divide(1.0, dt, out=np.zeros_like(dt), where=dt > 0.0)
    twist = np.stack((steps.ds_m, steps.dl_m, steps.dtheta_rad), axis=1) * rate[:, None]
    middle = t_s[:-1] + dt / 2.0
    travel = np.hypot(steps.ds_m, steps.dl_m)
    return Motion(
        t_s=t_s[1:],
        dt_s=dt,
        v=twist[:, 0],
        vy=twist[:, 1],
        omega=twist[:, 2],
        acceleration=slopes(middle, twist, middle, SMOOTHING_S),
        x=xyt[:-1, 0],
        y=xyt[:-1, 1],
        theta=xyt[:-1, 2],
        distance=np.cumsum(travel),
        track_m=track_m,
    )


def twist_error(effects: Iterable[Effect], motion: Motion) -> Array:
    """Return the sum (n, 3) of the effects' f over a whole motion; stamps are not touched, see `Effect.clock`.

    Correction knows nothing of the draws of a random effect, so these contribute their expectation: zero.
    """
    total = np.zeros((len(motion), 3))
    for effect in effects:
        if effect.kind != "noise" and not effect.clock:
            total += effect.twist_error(motion, effect.start(stream(0, 0, effect.name))).f
    return total


def corrected_increments(effects: Iterable[Effect], motion: Motion) -> Increments:
    """Return the increments u = u' + f(u') of the truth, from the odometry's motion u'."""
    twist = np.stack((motion.v, motion.vy, motion.omega), axis=1) + twist_error(effects, motion)
    step = twist * motion.dt_s[:, None]
    return Increments(*np.ascontiguousarray(step.T))

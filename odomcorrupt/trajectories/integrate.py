"""Wheel odometry integrated from velocities, clean and with white noise on them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, get_args

import numpy as np

from odomcorrupt.errors import ModelError
from odomcorrupt.rng import stream

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

__all__ = ["RULES", "Hold", "Rule", "integrate", "noisy_twists"]

Rule = Literal["euler", "midpoint", "exact"]
Hold = Literal["next", "previous"]

RULES: tuple[Rule, ...] = get_args(Rule)


def integrate(start_xyt: Array, twist: Array, t_s: Array, rule: Rule, *, hold: Hold = "next") -> Array:
    """Return poses (..., n, 3) at n stamps, the first one being the start.

    Parameters
    ----------
    start_xyt : (3,)
        Metres and radians.
    twist : (..., n, 3)
        vx, vy in m/s and yaw rate in rad/s, in the robot's frame.
    t_s : (n,)
        Ascending times, seconds.
    rule
        Over an interval of constant twist: a straight line along the initial heading (`euler`) or the heading at
        mid-interval (`midpoint`), or the circular arc (`exact`).
    hold
        Whether a twist holds from its stamp to the next one (`next`), or from the previous one to its own.

    """
    if rule not in RULES:
        raise ModelError(f"rule {rule}: is not one of {', '.join(RULES)}")
    held = twist[..., :-1, :] if hold == "next" else twist[..., 1:, :]
    step = held * np.diff(t_s)[:, None]
    turn = step[..., 2]
    first = np.broadcast_to(start_xyt[2], (*turn.shape[:-1], 1))
    theta = np.cumsum(np.concatenate((first, turn), axis=-1), axis=-1)
    along = theta[..., :-1] + (0.0 if rule == "euler" else turn / 2.0)
    # length of the chord over that of the arc
    length = np.sinc(turn / (2.0 * np.pi)) if rule == "exact" else 1.0
    c, s = np.cos(along) * length, np.sin(along) * length
    out = np.empty((*theta.shape, 3))
    out[..., 0, :2] = start_xyt[:2]
    out[..., 1:, 0] = c * step[..., 0] - s * step[..., 1]
    out[..., 1:, 1] = s * step[..., 0] + c * step[..., 1]
    out[..., :2] = np.cumsum(out[..., :2], axis=-2)
    out[..., 2] = theta
    return out


def noisy_twists(twist: Array, sd_v: float, sd_omega: float, *, seed: int, runs: range) -> Array:
    """Return twists (runs, n, 3) with independent normal noise of sd_v (m/s) and sd_omega (rad/s) on each.

    The variance of the drift is proportional to the time between messages.
    Run k does not depend on the number of runs drawn.
    """
    if not (np.isfinite([sd_v, sd_omega]).all() and min(sd_v, sd_omega) >= 0.0):
        raise ModelError(f"twist noise: {sd_v} m/s, {sd_omega} rad/s; both must be zero or more")
    out = np.repeat(twist[None], len(runs), axis=0)
    for row, run in zip(out, runs, strict=True):
        draws = stream(seed, run, "twist_noise").standard_normal((len(twist), 2))
        row[:, 0] += sd_v * draws[:, 0]
        row[:, 2] += sd_omega * draws[:, 1]
    return out

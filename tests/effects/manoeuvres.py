"""Hand-made manoeuvres, as an odometry reports them: what an effect says of each can be worked out on paper."""

import numpy as np

from odomcorrupt.effects import effect_from_values
from odomcorrupt.effects.compensation import error_of
from odomcorrupt.effects.effect import Motion
from odomcorrupt.geometry.motion import accelerations
from odomcorrupt.geometry.se2 import Increments, accumulate

RATE_HZ = 50.0


def motion(v, omega, seconds=1.0, *, track=None, heading=0.0, xy=(0.0, 0.0), vy=0.0):
    """Return a motion at given speeds: numbers, or arrays over the intervals."""
    n = round(seconds * RATE_HZ)
    v, vy, omega = (np.broadcast_to(np.asarray(x, dtype=float), n).copy() for x in (v, vy, omega))
    dt = np.full(n, 1.0 / RATE_HZ)
    faster = accelerations(np.stack((v, vy, omega), axis=1), dt)
    poses = accumulate(np.array([*xy, heading]), Increments(v * dt, vy * dt, omega * dt))
    return Motion(
        t_s=np.cumsum(dt), dt_s=dt, v=v, vy=vy, omega=omega, acceleration=faster.rate, trail=faster.trail,
        x=poses[:-1, 0].copy(), y=poses[:-1, 1].copy(), theta=poses[:-1, 2].copy(),
        distance=np.cumsum(np.hypot(v, vy) * dt), track_m=track,
    )  # fmt: skip


def error(name, values, drive):
    return error_of(effect_from_values(name, values), drive)


def total(name, values, drive):
    """Return truth minus odometry, summed over the drive in the body: metres along, metres left, radians."""
    return (error(name, values, drive) * drive.dt_s[:, None]).sum(axis=0)


STRAIGHT = {"v": 0.5, "omega": 0.0}
REVERSE = {"v": -0.5, "omega": 0.0}
CIRCLE = {"v": 0.5, "omega": 0.8}
SPIN = {"v": 0.0, "omega": 1.0}
STOP = {"v": 0.0, "omega": 0.0}

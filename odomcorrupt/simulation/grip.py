"""How much of the way a wheel rolls the floor takes: slips of one wheel by its speed, by chance and by its place."""

import numpy as np
from scipy.signal import lfilter

from odomcorrupt.simulation.floor import Bursts, Floor, Slippery
from odomcorrupt.simulation.robot import Robot
from odomcorrupt.simulation.streams import Streams

COARSE = 10
"""Grid steps over which a wheel counts as being in one place (20 ms: less than the length of a contact patch)."""
WEIGHT_SHIFT_S = 0.1
"""How soon braking is felt by the wheels."""


def lose_by_speed(travel_m: np.ndarray, rim_mps: np.ndarray, step_s: float, floor: Floor) -> np.ndarray:
    """Return the travel of each wheel (n, 2), m, less what a too fast wheel loses, plus what a dragged one gains.

    Parameters
    ----------
    rim_mps : ndarray, shape (n, 2)
        Speed at which each wheel turns, at its rim.
    """
    speed_mps = np.abs(rim_mps)
    if np.isfinite(floor.grip_mps):
        travel_m = np.where(speed_mps > floor.grip_mps, (1.0 - floor.grip_slip) * travel_m, travel_m)
    if np.isfinite(floor.braking_mps2):
        keep = np.exp(-step_s / WEIGHT_SHIFT_S)
        felt_mps = lfilter([1.0 - keep], [1.0, -keep], speed_mps.mean(axis=1))
        dragged = -np.gradient(felt_mps, step_s) > floor.braking_mps2
        travel_m = np.where(dragged[:, None], (1.0 + floor.braking_slip) * travel_m, travel_m)
    return travel_m


def lose_by_chance(travel_m: np.ndarray, step_s: float, bursts: Bursts, rng: np.random.Generator) -> np.ndarray:
    """Return the travel of each wheel (n, 2), m, less what bursts take.

    Bursts begin at random; each wheel loses a part of its own, from next to nothing to everything, of the given mean.
    """
    steps = len(travel_m)
    lost = np.zeros_like(travel_m)
    for _ in range(rng.poisson(bursts.rate_hz * steps * step_s) if 0.0 < bursts.slip < 1.0 else 0):
        begin = rng.integers(steps)
        end = begin + round(bursts.duration_s * rng.uniform(0.5, 1.5) / step_s)
        slip = rng.beta(2.0 * bursts.slip, 2.0 * (1.0 - bursts.slip), size=2)
        lost[begin:end] = np.maximum(lost[begin:end], slip)
    return travel_m * (1.0 - lost)


def lose_by_place(
    travel_m: np.ndarray, drift: np.ndarray, robot: Robot, slippery: tuple[Slippery, ...], start_xyt: np.ndarray
) -> np.ndarray:
    """Return the travel of each wheel, less what it loses where it stands at the moment.

    Parameters
    ----------
    travel_m : ndarray, shape (n, 2)
        Travel of the right and left wheel per step, m.
    drift : ndarray of complex, shape (n,)
        What the body moves besides, in its own frame, m.
    start_xyt : ndarray, shape (3,)
        Where the body begins, in the truth frame; m, m, rad.

    Returns
    -------
    ndarray, shape (n, 2)
    """
    edges = np.arange(0, len(travel_m), COARSE)
    blocks_m = np.add.reduceat(travel_m, edges, axis=0).tolist()
    drifts = np.add.reduceat(drift, edges).tolist()
    place, heading_rad = complex(start_xyt[0], start_xyt[1]), float(start_xyt[2])
    keeps = []
    for (right_m, left_m), aside in zip(blocks_m, drifts, strict=True):
        facing = complex(np.cos(heading_rad), np.sin(heading_rad))
        keep_right = keep_left = 1.0
        for patch in slippery:
            arm = 0.5j * robot.track_m * facing * patch.by_wheel
            keep_right *= 1.0 - patch.slip * patch.place.holds(place - arm)
            keep_left *= 1.0 - patch.slip * patch.place.holds(place + arm)
        keeps.append((keep_right, keep_left))
        right_m, left_m = keep_right * right_m, keep_left * left_m  # noqa: PLW2901 - the same way, less the slip
        turn_rad = (right_m - left_m) / robot.track_m
        midway = facing * complex(1.0, 0.5 * turn_rad)
        place += (0.5 * (right_m + left_m) + aside) * midway
        heading_rad += turn_rad
    return np.asarray(travel_m * np.repeat(np.array(keeps), COARSE, axis=0)[: len(travel_m)])


def hold(travel_m: np.ndarray, rim_mps: np.ndarray, step_s: float, robot: Robot, streams: Streams) -> np.ndarray:
    """Return what the floor takes of each wheel's rolling (n, 2), m, wherever it is."""
    travel_m = lose_by_speed(travel_m, rim_mps, step_s, robot.floor)
    for i, bursts in enumerate(robot.floor.bursts):
        travel_m = lose_by_chance(travel_m, step_s, bursts, streams.open(f"bursts {i}"))
    return travel_m

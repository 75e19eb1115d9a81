"""What a cause is: a change of the machine or its floor, and how much of it a run gets."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from odomcorrupt.simulation.robot import Robot

Parameters: TypeAlias = Mapping[str, float | str]
Drawn: TypeAlias = dict[str, float | str]


@dataclass(frozen=True, slots=True)
class Cause:
    """One flaw: the range of its magnitude, how a magnitude becomes parameters, and what it does to the machine.

    Attributes
    ----------
    low, high : float
        Range of the magnitude at medium size.
    draw : callable
        Magnitude and generator in, parameters out.
    spoil : callable
        Robot and parameters in, flawed robot out.
    yaw_from : {"encoders", "gyro"}
        The driver's source of turns unless one is asked for.
    shows_with : tuple of str
        Sources of turns with which the flaw is an error of the odometry.
    place : callable or None
        Where on the floor it is, drawn along a path (complex, m) of the truth frame.
    depends_on : str
        What the odometry's error depends on, for causes that are in no library.
    one_signed : bool
        Whether its magnitude (the first parameter) must not be negative.
    """

    low: float
    high: float
    draw: Callable[[float, np.random.Generator], Drawn]
    spoil: Callable[[Robot, Mapping[str, Any]], Robot]
    yaw_from: str = "encoders"
    shows_with: tuple[str, ...] = ("encoders", "gyro")
    place: Callable[[np.ndarray, np.random.Generator], Drawn] | None = None
    depends_on: str = ""
    one_signed: bool = False


def either_sign(name: str) -> Callable[[float, np.random.Generator], Drawn]:
    """Draw the sign of the only parameter."""
    return lambda magnitude, rng: {name: magnitude * rng.choice((-1.0, 1.0))}


def positive(name: str) -> Callable[[float, np.random.Generator], Drawn]:
    """Have one parameter that knows no sign."""
    return lambda magnitude, _: {name: magnitude}


def with_angle(name: str, angle: str) -> Callable[[float, np.random.Generator], Drawn]:
    """Draw a direction, rad, beside the magnitude."""
    return lambda magnitude, rng: {name: magnitude, angle: rng.uniform(-np.pi, np.pi)}


def spot_on(path: np.ndarray, rng: np.random.Generator) -> tuple[complex, float]:
    """Draw a centre and a radius, m, of a part of the floor that a drive crosses often without living there.

    Parameters
    ----------
    path : ndarray of complex, shape (n,)
        Evenly timed places of the truth frame, m.
    """
    moved = np.abs(np.diff(path, append=path[-1:]))
    way_m = max(float(moved.sum()), 1e-9)
    best, best_merit = (complex(path[0]), 1.0), -np.inf
    for _ in range(40):
        centre, radius_m = complex(path[rng.choice(len(path), p=(moved + 1e-12) / (moved + 1e-12).sum())]), 1.0
        radius_m = float(rng.uniform(0.8, 1.8))
        centre += radius_m * rng.uniform(0.0, 0.6) * np.exp(1j * rng.uniform(-np.pi, np.pi))
        inside = np.abs(path - centre) < radius_m
        share = float(moved[inside].sum()) / way_m
        visits = int(np.count_nonzero(np.diff(inside.astype(np.int8)) == 1))
        from_home = abs(centre - path[0])
        merit = min(visits, 6) - 30.0 * max(0.08 - share, share - 0.35, 0.0) - 0.5 * max(from_home - 4.0, 0.0)
        if merit > best_merit:
            best, best_merit = (centre, radius_m), merit
    return best

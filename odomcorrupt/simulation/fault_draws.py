"""Selection of a robot's faults: given, or drawn at random, with parameters."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from odomcorrupt.errors import EffectError
from odomcorrupt.simulation.faults import CAUSES, OUTSIDE, Drawn, Parameters
from odomcorrupt.simulation.robot import Robot
from odomcorrupt.simulation.streams import stream

EVERY = {**CAUSES, **OUTSIDE}
"""All causes, those of the effects library and those outside it."""
SIZES = {"weak": 0.5, "medium": 1.0, "strong": 2.0}
TWINS = {"lever_arm", "icr_shift"}
"""Aliased faults, which no recording can distinguish: a mixture of them would be one fault."""
_LOT = {"none": 0.2, "one": 0.5, "two": 0.15, "outside": 0.15}


def draw_parameters(cause: str, size: float, rng: np.random.Generator) -> Drawn:
    """Return random parameters of a fault: magnitude log-uniform over its range times `size`, random sign.

    The place of a fault on the floor is not drawn here.

    cause : a key of `EVERY`
    size : factor on the magnitude; 1 is realistic
    """
    fault = EVERY[cause]
    magnitude = size * float(np.exp(rng.uniform(np.log(fault.low), np.log(fault.high))))
    return _plain(fault.draw(magnitude, rng))


def draw_fault(
    cause: str, size: float, robot_seed: int, path: np.ndarray | None, given: Parameters | None = None
) -> Drawn:
    """Return all parameters of a fault, with those not given drawn at random.

    path : (n,) planned path in the truth frame, x + iy in m, for faults that have a place; None if unknown

    Raises
    ------
    EffectError
        If a given parameter does not belong to the cause, or has the wrong kind or sign.
    """
    fault = EVERY[cause]
    drawn = draw_parameters(cause, size, stream(robot_seed, f"cause {cause}"))
    if fault.place is not None and path is not None:
        drawn |= _plain(fault.place(path, stream(robot_seed, f"place {cause}")))
    for name, value in (given or {}).items():
        if name not in drawn:
            raise EffectError(f"{cause}: has no parameter {name}; it has {', '.join(drawn)}")
        if isinstance(drawn[name], str) and value not in {"along", "yaw"}:
            raise EffectError(f"{cause}: {name} {value}; it can be along or yaw")
        if not isinstance(drawn[name], str) and isinstance(value, str):
            raise EffectError(f"{cause}: {name} {value} is no number")
    drawn |= given or {}
    first = next(iter(drawn.values()))
    if fault.one_signed and not isinstance(first, str) and first < 0:
        raise EffectError(f"{cause}: {next(iter(drawn))} {first}; this has no negative")
    return drawn


def with_faults(robot: Robot, faults: Mapping[str, Parameters]) -> Robot:
    """Return the robot with these faults."""
    for cause, parameters in faults.items():
        robot = EVERY[cause].apply(robot, parameters)
    return robot


def source_of_turns(causes: Sequence[str]) -> str:
    """Return the source of turns with which all these faults cause odometry errors.

    Raises
    ------
    EffectError
        If there is no such source.
    """
    for source in ("encoders", "gyro"):
        if all(source in EVERY[cause].shows_with for cause in causes):
            return source
    raise EffectError(f"{' and '.join(causes)}: need different sources of heading; choose causes that share one")


def names_of(cause: str | Sequence[str] | None) -> tuple[str, ...]:
    """Return the names of one, several or no faults.

    Raises
    ------
    EffectError
        If one is unknown or comes twice.
    """
    causes = (cause,) if isinstance(cause, str) else tuple(cause or ())
    for name in causes:
        if name not in EVERY:
            raise EffectError(f"{name}: is no cause; there are {', '.join(sorted(EVERY))}")
        if causes.count(name) > 1:
            raise EffectError(f"{name}: is there twice; name each cause once")
    return causes


def is_placed(causes: Sequence[str]) -> bool:
    """Return whether one of these faults has a place on the floor."""
    return any(EVERY[name].place is not None for name in causes)


@dataclass(frozen=True, slots=True)
class Hidden:
    """Randomly drawn faults: their names, and the odometry's source of turns."""

    causes: tuple[str, ...]
    yaw_from: str


def draw_causes(seed: int, yaw_from: str | None = None) -> Hidden:
    """Return randomly drawn faults: none, one of the library, two of them, or one outside the library.

    yaw_from : "encoders" or "gyro": draw only faults that matter with this source of turns; by default the source
        is drawn first, so that it does not reveal the fault
    """
    rng = stream(seed, "hidden")
    kind = rng.choice(list(_LOT), p=list(_LOT.values()))
    fair = str(rng.choice(("encoders", "gyro")))
    source = yaw_from or fair
    known = [name for name, fault in CAUSES.items() if source in fault.shows_with]
    if kind == "none":
        return Hidden((), source)
    if kind == "outside":
        foreign = [name for name, fault in OUTSIDE.items() if source in fault.shows_with]
        return Hidden((str(rng.choice(foreign)),), source)
    while True:
        causes = tuple(str(name) for name in rng.choice(known, size=1 + (kind == "two"), replace=False))
        if set(causes) != TWINS:
            return Hidden(causes, source)


def _plain(drawn: Drawn) -> Drawn:
    return {name: str(value) if isinstance(value, str) else float(value) for name, value in drawn.items()}

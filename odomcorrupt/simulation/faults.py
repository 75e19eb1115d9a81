"""Faults: changes of the machine or floor, named as in the effects library or outside it, given or drawn at random.

To add one, write a function that turns parameters into a changed `Robot` and enter it in `CAUSES` or `OUTSIDE`.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeAlias

import numpy as np

from odomcorrupt.errors import EffectError
from odomcorrupt.simulation.robot import Bursts, Floor, Robot, Slippery, stream

Parameters: TypeAlias = Mapping[str, float | str]
Drawn: TypeAlias = dict[str, float | str]


@dataclass(frozen=True, slots=True)
class Cause:
    """A fault: range of its magnitude, parameters for a magnitude, and change of the machine.

    low, high : range of the magnitude at medium size
    draw : magnitude and generator in, parameters out
    apply : robot and parameters in, faulty robot out
    shows_with : sources of turns with which the fault causes an odometry error
    place : random place on the floor along a path (complex, m) in the truth frame
    depends_on : regressor that the odometry error depends on, for faults outside the library
    one_signed : whether its magnitude (the first parameter) cannot be negative
    """

    low: float
    high: float
    draw: Callable[[float, np.random.Generator], Drawn]
    apply: Callable[[Robot, Mapping[str, Any]], Robot]
    shows_with: tuple[str, ...] = ("encoders", "gyro")
    place: Callable[[np.ndarray, np.random.Generator], Drawn] | None = None
    depends_on: str = ""
    one_signed: bool = False


def either_sign(name: str) -> Callable[[float, np.random.Generator], Drawn]:
    """Return a draw function for one parameter of random sign."""
    return lambda magnitude, rng: {name: magnitude * rng.choice((-1.0, 1.0))}


def positive(name: str) -> Callable[[float, np.random.Generator], Drawn]:
    """Return a draw function for one non-negative parameter."""
    return lambda magnitude, _: {name: magnitude}


def with_angle(name: str, angle: str) -> Callable[[float, np.random.Generator], Drawn]:
    """Return a draw function for a magnitude and a random direction, rad."""
    return lambda magnitude, rng: {name: magnitude, angle: rng.uniform(-np.pi, np.pi)}


def spot_on(path: np.ndarray, rng: np.random.Generator) -> tuple[complex, float]:
    """Return random centre and radius, m, of a part of the floor that a drive crosses often but does not stay in.

    path : (n,) complex, positions x + iy at even times in the truth frame, m
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


WHEELS, GYRO = ("encoders",), ("gyro",)


def _any_direction(magnitude: float, rng: np.random.Generator) -> Drawn:
    angle_rad = rng.uniform(-np.pi, np.pi)
    return {"x": magnitude * np.cos(angle_rad), "y": magnitude * np.sin(angle_rad)}


def _grow_both(robot: Robot, p: Mapping[str, Any]) -> Robot:
    larger = 1 + p["e"]
    return replace(robot, radius_right_m=robot.radius_right_m * larger, radius_left_m=robot.radius_left_m * larger)


def _grow_right_shrink_left(robot: Robot, p: Mapping[str, Any]) -> Robot:
    """Change the radii so that equal wheel speeds give the stated curvature, with nominal mean radius."""
    half = 0.5 * p["curvature"] * robot.nominal_track_m
    right_m, left_m = robot.radius_right_m * (1 + half), robot.radius_left_m * (1 - half)
    return replace(robot, radius_right_m=right_m, radius_left_m=left_m)


def _widen(robot: Robot, p: Mapping[str, Any]) -> Robot:
    return replace(robot, track_m=robot.track_m * (1 + p["e"]))


def _mark(robot: Robot, p: Mapping[str, Any]) -> Robot:
    x, y, yaw = robot.marker_xyt
    return replace(robot, marker_xyt=(x + p.get("x", 0.0), y + p.get("y", 0.0), yaw + p.get("yaw", 0.0)))


def _on_floor(robot: Robot, **changes: Any) -> Robot:
    return replace(robot, floor=replace(robot.floor, **changes))


def _wet(half: str, share: float = 1.0, *, by_wheel: bool) -> Callable[[Robot, Mapping[str, Any]], Robot]:
    """Return a function that adds a slippery place: a strip if the fault has a direction, else a round patch.

    half, share : parameter of which its half width is this share
    by_wheel : whether one wheel slips before the other at its edge and turns the robot
    """

    def apply(robot: Robot, p: Mapping[str, Any]) -> Robot:
        patch = Slippery(complex(p["x"], p["y"]), share * p[half], p["slip"], by_wheel, p.get("direction"))
        return _on_floor(robot, slippery=(*robot.floor.slippery, patch))

    return apply


def on_path(path: np.ndarray, rng: np.random.Generator) -> Drawn:
    """Return a random disc that a drive along `path` (complex, m) crosses often."""
    centre, radius_m = spot_on(path, rng)
    return {"x": centre.real, "y": centre.imag, "radius": radius_m}


def _tilt(robot: Robot, p: Mapping[str, Any]) -> Robot:
    pull = p["creep"] * complex(np.cos(p["direction"]), np.sin(p["direction"]))
    return _on_floor(robot, downhill=(*robot.floor.downhill, pull))


def _burst(robot: Robot, p: Mapping[str, Any]) -> Robot:
    return _on_floor(robot, bursts=(*robot.floor.bursts, Bursts(p["rate"], p["slip"], p["duration"])))


def _between(low: float, high: float, rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _wobble(robot: Robot, p: Mapping[str, Any]) -> Robot:
    wobble = (float(p["sigma"]), float(p["tau"]))
    if wobble[0] == 0.0:
        return robot
    if p["channel"] == "yaw":
        return replace(robot, play_of_track=(*robot.play_of_track, wobble))
    if p["channel"] == "wheels":
        return replace(robot, play_of_rims=(*robot.play_of_rims, wobble))
    return _on_floor(robot, uneven=(*robot.floor.uneven, wobble))


def _adds(parameter: str, name: str) -> Callable[[Robot, Mapping[str, Any]], Robot]:
    """Return a function that adds a fault's parameter to one field of the machine."""

    def apply(robot: Robot, p: Mapping[str, Any]) -> Robot:
        return replace(robot, **{name: getattr(robot, name) + p[parameter]})

    return apply


def _sets(**parameters: str) -> Callable[[Robot, Mapping[str, Any]], Robot]:
    """Return a function that sets fields of the machine or its floor to parameters of a fault: field=parameter."""
    change = _on_floor if parameters.keys() <= {field.name for field in fields(Floor)} else replace
    return lambda robot, p: change(robot, **{name: p[parameter] for name, parameter in parameters.items()})


CAUSES: dict[str, Cause] = {
    "wheel_scale": Cause(0.005, 0.02, either_sign("e"), _grow_both),
    "unequal_wheels": Cause(0.003, 0.015, either_sign("curvature"), _grow_right_shrink_left, shows_with=WHEELS),
    "wheelbase": Cause(0.01, 0.04, either_sign("e"), _widen, shows_with=WHEELS),
    "lever_arm": Cause(0.02, 0.08, _any_direction, _mark),
    "mount_yaw": Cause(np.radians(1.0), np.radians(4.0), either_sign("yaw"), _mark),
    "icr_shift": Cause(0.02, 0.08, either_sign("x"), _adds("x", "rotation_centre_behind_m")),
    "gyro_bias": Cause(0.002, 0.01, either_sign("bias"), _adds("bias", "gyro_bias_radps"), shows_with=GYRO),
    "gyro_bias_walk": Cause(
        1e-4, 5e-4, positive("density"), _adds("density", "gyro_walk_radps_per_sqrt_s"), shows_with=GYRO,
        one_signed=True,
    ),
    "gyro_scale": Cause(0.005, 0.03, either_sign("e"), _adds("e", "gyro_scale"), shows_with=GYRO),
    # A tyre yields only in the direction of the force: these two are non-negative.
    "side_slip": Cause(0.01, 0.05, positive("k"), _adds("k", "lateral_creep_s"), one_signed=True),
    "accel_slip": Cause(0.02, 0.06, positive("k"), _adds("k", "traction_s2_per_m"), one_signed=True),
    "speed_scale": Cause(0.008, 0.03, either_sign("k"), _adds("k", "growth_s_per_m")),
    "region_slip": Cause(0.03, 0.1, positive("slip"), _wet("radius", by_wheel=False), place=on_path),
    "slope": Cause(0.008, 0.03, with_angle("creep", "direction"), _tilt),
    "turn_asymmetry": Cause(0.008, 0.03, either_sign("k"), _adds("k", "lean"), shows_with=WHEELS),
    "scale_drift": Cause(1e-5, 4e-5, either_sign("rate"), _adds("rate", "warming_per_s")),
    "backlash": Cause(0.003, 0.012, positive("travel"), _adds("travel", "gear_play_m"), one_signed=True),
    "slip_burst": Cause(
        0.02, 0.08, lambda rate, rng: {"rate": rate, "slip": rng.uniform(0.3, 0.6), "duration": rng.uniform(0.1, 0.3)},
        _burst, one_signed=True,
    ),
    "gauss_markov": Cause(
        0.01, 0.05,
        lambda sigma, rng: {"sigma": sigma, "tau": _between(2.0, 30.0, rng), "channel": rng.choice(("along", "yaw"))},
        _wobble, one_signed=True,
    ),
    "heavy_tails": Cause(
        0.2, 0.45, lambda magnitude, _: {"inverse_dof": min(magnitude, 0.7)},
        _sets(jolts_inverse_dof="inverse_dof"), one_signed=True,
    ),
    "quantization": Cause(0.002, 0.01, positive("step"), _adds("step", "tick_travel_m"), one_signed=True),
    "lost_increments": Cause(0.005, 0.03, positive("fraction"), _adds("fraction", "lost_cycles"), one_signed=True),
    "time_offset": Cause(0.02, 0.1, either_sign("offset"), _adds("offset", "odom_clock_offset_s")),
    "clock_skew": Cause(5e-5, 3e-4, either_sign("rate"), _adds("rate", "odom_clock_rate")),
}  # fmt: skip


def _across(path: np.ndarray, rng: np.random.Generator) -> Drawn:
    centre, radius_m = spot_on(path, rng)
    direction_rad = float(rng.uniform(-np.pi, np.pi))
    return {"x": centre.real, "y": centre.imag, "direction": direction_rad, "width": radius_m}


OUTSIDE: dict[str, Cause] = {
    "eccentric_wheel": Cause(
        0.02, 0.06, with_angle("e", "phase"), _sets(eccentricity="e", eccentric_from_rad="phase"),
        shows_with=WHEELS, depends_on="distance", one_signed=True,
    ),
    "magnetic_heading": Cause(
        0.02, 0.08, with_angle("amplitude", "direction"),
        _sets(hard_iron_rad="amplitude", hard_iron_from_rad="direction"),
        shows_with=GYRO, depends_on="heading", one_signed=True,
    ),
    "floor_grain": Cause(
        0.01, 0.03, with_angle("creep", "direction"), _sets(grain="creep", grain_from_rad="direction"),
        depends_on="heading", one_signed=True,
    ),
    "overspeed_slip": Cause(
        0.02, 0.06, lambda slip, rng: {"slip": slip, "speed": rng.uniform(0.5, 0.7)},
        _sets(grip_mps="speed", grip_slip="slip"), depends_on="speed",
    ),
    "braking_drag": Cause(
        0.05, 0.15, lambda slip, rng: {"slip": slip, "deceleration": rng.uniform(0.2, 0.4)},
        _sets(braking_mps2="deceleration", braking_slip="slip"), depends_on="acceleration",
    ),
    "load_shift": Cause(
        0.0008, 0.003,
        lambda squeeze, rng: {"squeeze": squeeze * rng.choice((-1.0, 1.0)), "time": rng.uniform(120.0, 360.0)},
        _sets(load_squeeze="squeeze", load_shift_s="time"), shows_with=WHEELS, depends_on="time",
    ),
    "turn_scrub": Cause(
        0.02, 0.06, either_sign("k"), _sets(scrub_s="k"), shows_with=WHEELS, depends_on="yaw_rate"
    ),
    "wet_patch": Cause(
        0.03, 0.1, positive("slip"), _wet("radius", by_wheel=True), place=on_path, depends_on="position"
    ),
    "wet_strip": Cause(
        0.03, 0.1, positive("slip"), _wet("width", 0.5, by_wheel=True), place=_across, depends_on="position"
    ),
}  # fmt: skip
EVERY = {**CAUSES, **OUTSIDE}
"""All causes, those of the effects library and those outside it."""
SIZES = {"weak": 0.5, "medium": 1.0, "strong": 2.0}
TWINS = {"lever_arm", "icr_shift"}
"""Aliased faults, which no recording can distinguish: a mixture of them would be one fault."""
_CHANNELS = ("along", "yaw", "wheels")
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
        if isinstance(drawn[name], str) and value not in _CHANNELS:
            raise EffectError(f"{cause}: {name} {value}; it can be {', '.join(_CHANNELS[:-1])} or {_CHANNELS[-1]}")
        if not isinstance(drawn[name], str) and isinstance(value, str):
            raise EffectError(f"{cause}: {name} {value} is not a number")
    drawn |= given or {}
    first = next(iter(drawn.values()))
    if fault.one_signed and not isinstance(first, str) and first < 0:
        raise EffectError(f"{cause}: {next(iter(drawn))} {first}; it must not be negative")
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
            raise EffectError(f"{name}: is not a cause; there are {', '.join(sorted(EVERY))}")
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

"""Faults: changes of the machine or floor, named as in the effects library, and others outside the library.

To add one, write a function that turns parameters into a changed `Robot` and enter it in `CAUSES` or `OUTSIDE`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

import numpy as np

from odomcorrupt.simulation.robot import Bursts, Disc, Robot, Slippery, Strip

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


def _slippery(robot: Robot, place: Disc | Strip, slip: float, *, by_wheel: bool) -> Robot:
    return _on_floor(robot, slippery=(*robot.floor.slippery, Slippery(place, slip, by_wheel)))


def _wet(robot: Robot, p: Mapping[str, Any]) -> Robot:
    return _slippery(robot, Disc(p["x"], p["y"], p["radius"]), p["slip"], by_wheel=False)


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
    return _on_floor(robot, uneven=(*robot.floor.uneven, wobble))


def _adds(parameter: str, name: str) -> Callable[[Robot, Mapping[str, Any]], Robot]:
    """Return a function that adds a fault's parameter to one field of the machine."""

    def apply(robot: Robot, p: Mapping[str, Any]) -> Robot:
        return replace(robot, **{name: getattr(robot, name) + p[parameter]})

    return apply


def _sets(**parameters: str) -> Callable[[Robot, Mapping[str, Any]], Robot]:
    """Return a function that sets fields of the machine to parameters of a fault: field=parameter."""
    return lambda robot, p: replace(robot, **{name: p[parameter] for name, parameter in parameters.items()})


def _sets_floor(**parameters: str) -> Callable[[Robot, Mapping[str, Any]], Robot]:
    """Return a function that sets fields of the floor to parameters of a fault: field=parameter."""
    return lambda robot, p: _on_floor(robot, **{name: p[parameter] for name, parameter in parameters.items()})


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
    "region_slip": Cause(0.03, 0.1, positive("slip"), _wet, place=on_path),
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
        _sets_floor(jolts_inverse_dof="inverse_dof"), one_signed=True,
    ),
    "quantization": Cause(0.002, 0.01, positive("step"), _adds("step", "tick_travel_m"), one_signed=True),
    "lost_increments": Cause(0.005, 0.03, positive("fraction"), _adds("fraction", "lost_cycles"), one_signed=True),
    "time_offset": Cause(0.02, 0.1, either_sign("offset"), _adds("offset", "odom_clock_offset_s")),
    "clock_skew": Cause(5e-5, 3e-4, either_sign("rate"), _adds("rate", "odom_clock_rate")),
}  # fmt: skip


def _wet_patch(robot: Robot, p: Mapping[str, Any]) -> Robot:
    """Add a patch at whose edge one wheel slips before the other and turns the robot."""
    return _slippery(robot, Disc(p["x"], p["y"], p["radius"]), p["slip"], by_wheel=True)


def _wet_strip(robot: Robot, p: Mapping[str, Any]) -> Robot:
    return _slippery(robot, Strip(p["x"], p["y"], p["direction"], 0.5 * p["width"]), p["slip"], by_wheel=True)


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
        0.01, 0.03, with_angle("creep", "direction"), _sets_floor(grain="creep", grain_from_rad="direction"),
        depends_on="heading", one_signed=True,
    ),
    "overspeed_slip": Cause(
        0.02, 0.06, lambda slip, rng: {"slip": slip, "speed": rng.uniform(0.5, 0.7)},
        _sets_floor(grip_mps="speed", grip_slip="slip"), depends_on="speed",
    ),
    "braking_drag": Cause(
        0.05, 0.15, lambda slip, rng: {"slip": slip, "deceleration": rng.uniform(0.2, 0.4)},
        _sets_floor(braking_mps2="deceleration", braking_slip="slip"), depends_on="acceleration",
    ),
    "load_shift": Cause(
        0.0008, 0.003,
        lambda squeeze, rng: {"squeeze": squeeze * rng.choice((-1.0, 1.0)), "time": rng.uniform(120.0, 360.0)},
        _sets(load_squeeze="squeeze", load_shift_s="time"), shows_with=WHEELS, depends_on="time",
    ),
    "turn_scrub": Cause(
        0.02, 0.06, either_sign("k"), _sets(scrub_s="k"), shows_with=WHEELS, depends_on="yaw_rate"
    ),
    "wet_patch": Cause(0.03, 0.1, positive("slip"), _wet_patch, place=on_path, depends_on="position"),
    "wet_strip": Cause(0.03, 0.1, positive("slip"), _wet_strip, place=_across, depends_on="position"),
}  # fmt: skip

"""What can be wrong with the machine and is in the effects' table, with that table's names, parameters and signs.

To add one, write a function that turns parameters into a changed `Robot` and enter it in `CAUSES`.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from odomcorrupt.simulation.fault import Cause, Drawn, either_sign, positive, spot_on, with_angle
from odomcorrupt.simulation.floor import Bursts, Disc, Slippery
from odomcorrupt.simulation.robot import Robot

WHEELS, GYRO = ("encoders",), ("gyro",)


def _any_direction(magnitude: float, rng: np.random.Generator) -> Drawn:
    angle_rad = rng.uniform(-np.pi, np.pi)
    return {"x": magnitude * np.cos(angle_rad), "y": magnitude * np.sin(angle_rad)}


def _grow_both(robot: Robot, p: Mapping[str, Any]) -> Robot:
    return replace(
        robot,
        radius_right_m=robot.radius_right_m * (1 + p["e"]),
        radius_left_m=robot.radius_left_m * (1 + p["e"]),
    )


def _grow_right_shrink_left(robot: Robot, p: Mapping[str, Any]) -> Robot:
    """Make wheels that turn equally fast roll on a circle of the wanted curvature, the mean radius being nominal."""
    half = 0.5 * p["curvature"] * robot.nominal_track_m
    return replace(
        robot,
        radius_right_m=robot.radius_right_m * (1 + half),
        radius_left_m=robot.radius_left_m * (1 - half),
    )


def _mark(robot: Robot, p: Mapping[str, Any]) -> Robot:
    x, y, yaw = robot.marker_xyt
    return replace(robot, marker_xyt=(x + p.get("x", 0.0), y + p.get("y", 0.0), yaw + p.get("yaw", 0.0)))


def _wet(robot: Robot, p: Mapping[str, Any]) -> Robot:
    patch = Slippery(Disc(p["x"], p["y"], p["radius"]), p["slip"], by_wheel=False)
    return replace(robot, floor=replace(robot.floor, slippery=(*robot.floor.slippery, patch)))


def on_path(path: np.ndarray, rng: np.random.Generator) -> Drawn:
    """Draw a disc that a drive along `path` (complex, m) crosses often."""
    centre, radius_m = spot_on(path, rng)
    return {"x": centre.real, "y": centre.imag, "radius": radius_m}


def _tilt(robot: Robot, p: Mapping[str, Any]) -> Robot:
    pull = p["creep"] * complex(np.cos(p["direction"]), np.sin(p["direction"]))
    return replace(robot, floor=replace(robot.floor, downhill=(*robot.floor.downhill, pull)))


def _burst(robot: Robot, p: Mapping[str, Any]) -> Robot:
    bursts = Bursts(p["rate"], p["slip"], p["duration"])
    return replace(robot, floor=replace(robot.floor, bursts=(*robot.floor.bursts, bursts)))


def _roughen(robot: Robot, p: Mapping[str, Any]) -> Robot:
    return replace(robot, floor=replace(robot.floor, jolts_inverse_dof=p["inverse_dof"]))


def _between(low: float, high: float, rng: np.random.Generator) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _wobble(robot: Robot, p: Mapping[str, Any]) -> Robot:
    wobble = (float(p["sigma"]), float(p["tau"]))
    if wobble[0] == 0.0:
        return robot
    if p["channel"] == "yaw":
        return replace(robot, play_of_track=(*robot.play_of_track, wobble))
    return replace(robot, floor=replace(robot.floor, uneven=(*robot.floor.uneven, wobble)))


def _adds(parameter: str, name: str) -> Callable[[Robot, Mapping[str, Any]], Robot]:
    """Return how a cause spoils one field of the machine, to which its parameter adds."""

    def spoil(robot: Robot, p: Mapping[str, Any]) -> Robot:
        return replace(robot, **{name: getattr(robot, name) + p[parameter]})

    return spoil


CAUSES: dict[str, Cause] = {
    "wheel_scale": Cause(0.005, 0.02, either_sign("e"), _grow_both),
    "unequal_wheels": Cause(0.003, 0.015, either_sign("curvature"), _grow_right_shrink_left, shows_with=WHEELS),
    "wheelbase": Cause(
        0.01,
        0.04,
        either_sign("e"),
        lambda robot, p: replace(robot, track_m=robot.track_m * (1 + p["e"])),
        shows_with=WHEELS,
    ),
    "lever_arm": Cause(0.02, 0.08, _any_direction, _mark),
    "mount_yaw": Cause(np.radians(1.0), np.radians(4.0), either_sign("yaw"), _mark),
    "icr_shift": Cause(0.02, 0.08, either_sign("x"), _adds("x", "rotation_centre_behind_m")),
    "gyro_bias": Cause(
        0.002, 0.01, either_sign("bias"), _adds("bias", "gyro_bias_radps"), yaw_from="gyro", shows_with=GYRO
    ),
    "gyro_bias_walk": Cause(
        1e-4,
        5e-4,
        positive("density"),
        _adds("density", "gyro_walk_radps_per_sqrt_s"),
        yaw_from="gyro",
        shows_with=GYRO,
        one_signed=True,
    ),
    "gyro_scale": Cause(0.005, 0.03, either_sign("e"), _adds("e", "gyro_scale"), yaw_from="gyro", shows_with=GYRO),
    # A tyre can only yield to the side it is pushed to: these two have no negative.
    "side_slip": Cause(0.01, 0.05, positive("k"), _adds("k", "lateral_creep_s"), one_signed=True),
    "accel_slip": Cause(0.02, 0.06, positive("k"), _adds("k", "traction_s2_per_m"), one_signed=True),
    "speed_scale": Cause(0.008, 0.03, either_sign("k"), _adds("k", "growth_s_per_m")),
    "region_slip": Cause(0.03, 0.1, positive("slip"), _wet, place=on_path),
    "slope": Cause(0.008, 0.03, with_angle("creep", "direction"), _tilt),
    "turn_asymmetry": Cause(0.008, 0.03, either_sign("k"), _adds("k", "lean"), shows_with=WHEELS),
    "scale_drift": Cause(1e-5, 4e-5, either_sign("rate"), _adds("rate", "warming_per_s")),
    "backlash": Cause(0.003, 0.012, positive("travel"), _adds("travel", "gear_play_m"), one_signed=True),
    "slip_burst": Cause(
        0.02,
        0.08,
        lambda rate, rng: {"rate": rate, "slip": rng.uniform(0.3, 0.6), "duration": rng.uniform(0.1, 0.3)},
        _burst,
        one_signed=True,
    ),
    "gauss_markov": Cause(
        0.01,
        0.05,
        lambda sigma, rng: {"sigma": sigma, "tau": _between(2.0, 30.0, rng), "channel": rng.choice(("along", "yaw"))},
        _wobble,
        one_signed=True,
    ),
    "heavy_tails": Cause(
        0.2, 0.45, lambda magnitude, _: {"inverse_dof": min(magnitude, 0.7)}, _roughen, one_signed=True
    ),
    "quantization": Cause(0.002, 0.01, positive("step"), _adds("step", "tick_travel_m"), one_signed=True),
    "lost_increments": Cause(0.005, 0.03, positive("fraction"), _adds("fraction", "lost_cycles"), one_signed=True),
    "time_offset": Cause(0.02, 0.1, either_sign("offset"), _adds("offset", "odom_clock_offset_s")),
    "clock_skew": Cause(5e-5, 3e-4, either_sign("rate"), _adds("rate", "odom_clock_rate")),
}

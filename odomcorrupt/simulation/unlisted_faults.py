"""Causes that are in no library of effects: what a robot can have and a table does not name.

Each says on what the odometry's error depends, which is all that an honest diagnosis can find.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from odomcorrupt.simulation.fault import Cause, Drawn, either_sign, positive, spot_on, with_angle
from odomcorrupt.simulation.floor import Disc, Slippery, Strip
from odomcorrupt.simulation.library_faults import GYRO, WHEELS, on_path
from odomcorrupt.simulation.robot import Robot


def _off_centre(robot: Robot, p: Mapping[str, Any]) -> Robot:
    return replace(robot, eccentricity=p["e"], eccentric_from_rad=p["phase"])


def _magnetise(robot: Robot, p: Mapping[str, Any]) -> Robot:
    return replace(robot, hard_iron_rad=p["amplitude"], hard_iron_from_rad=p["direction"])


def _let_go_when_fast(robot: Robot, p: Mapping[str, Any]) -> Robot:
    return replace(robot, floor=replace(robot.floor, grip_mps=p["speed"], grip_slip=p["slip"]))


def _drag_when_braking(robot: Robot, p: Mapping[str, Any]) -> Robot:
    return replace(robot, floor=replace(robot.floor, braking_mps2=p["deceleration"], braking_slip=p["slip"]))


def _slide_the_load(robot: Robot, p: Mapping[str, Any]) -> Robot:
    return replace(robot, load_squeeze=p["squeeze"], load_shift_s=p["time"])


def _lay_carpet(robot: Robot, p: Mapping[str, Any]) -> Robot:
    return replace(robot, floor=replace(robot.floor, grain=p["creep"], grain_from_rad=p["direction"]))


def _scrub(robot: Robot, p: Mapping[str, Any]) -> Robot:
    return replace(robot, scrub_s=p["k"])


def _wet_patch(robot: Robot, p: Mapping[str, Any]) -> Robot:
    """Lay a patch at whose edge one wheel slips before the other: it kicks the robot round."""
    patch = Slippery(Disc(p["x"], p["y"], p["radius"]), p["slip"], by_wheel=True)
    return replace(robot, floor=replace(robot.floor, slippery=(*robot.floor.slippery, patch)))


def _wet_strip(robot: Robot, p: Mapping[str, Any]) -> Robot:
    patch = Slippery(Strip(p["x"], p["y"], p["direction"], 0.5 * p["width"]), p["slip"], by_wheel=True)
    return replace(robot, floor=replace(robot.floor, slippery=(*robot.floor.slippery, patch)))


def _across(path: np.ndarray, rng: np.random.Generator) -> Drawn:
    centre, radius_m = spot_on(path, rng)
    direction_rad = float(rng.uniform(-np.pi, np.pi))
    return {"x": centre.real, "y": centre.imag, "direction": direction_rad, "width": radius_m}


OUTSIDE: dict[str, Cause] = {
    "eccentric_wheel": Cause(
        0.02, 0.06, with_angle("e", "phase"), _off_centre, shows_with=WHEELS, depends_on="distance", one_signed=True
    ),
    "magnetic_heading": Cause(
        0.02,
        0.08,
        with_angle("amplitude", "direction"),
        _magnetise,
        yaw_from="gyro",
        shows_with=GYRO,
        depends_on="heading",
        one_signed=True,
    ),
    "floor_grain": Cause(
        0.01, 0.03, with_angle("creep", "direction"), _lay_carpet, depends_on="heading", one_signed=True
    ),
    "overspeed_slip": Cause(
        0.02,
        0.06,
        lambda slip, rng: {"slip": slip, "speed": rng.uniform(0.5, 0.7)},
        _let_go_when_fast,
        depends_on="speed",
    ),
    "braking_drag": Cause(
        0.05,
        0.15,
        lambda slip, rng: {"slip": slip, "deceleration": rng.uniform(0.2, 0.4)},
        _drag_when_braking,
        depends_on="acceleration",
    ),
    "load_shift": Cause(
        0.0008,
        0.003,
        lambda squeeze, rng: {"squeeze": squeeze * rng.choice((-1.0, 1.0)), "time": rng.uniform(120.0, 360.0)},
        _slide_the_load,
        shows_with=WHEELS,
        depends_on="time",
    ),
    "turn_scrub": Cause(0.02, 0.06, either_sign("k"), _scrub, shows_with=WHEELS, depends_on="yaw_rate"),
    "wet_patch": Cause(0.03, 0.1, positive("slip"), _wet_patch, place=on_path, depends_on="position"),
    "wet_strip": Cause(0.03, 0.1, positive("slip"), _wet_strip, place=_across, depends_on="position"),
}

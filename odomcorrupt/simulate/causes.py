"""What can be wrong with the machine, and how much of it a run gets.

Each cause turns its drawn parameters into a changed `Robot`. To add one, write such a function and enter it in
`CAUSES`.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from odomcorrupt.simulate.robot import Robot


@dataclass(frozen=True, slots=True)
class Cause:
    """One flaw: the range of its magnitude, how a magnitude becomes parameters, and what it does to the machine."""

    low: float
    high: float
    draw: Callable[[float, np.random.Generator], dict[str, float]]
    spoil: Callable[[Robot, dict[str, float]], Robot]
    yaw_from: str = "encoders"


def _either_sign(name: str) -> Callable[[float, np.random.Generator], dict[str, float]]:
    return lambda magnitude, rng: {name: magnitude * rng.choice((-1.0, 1.0))}


def _any_direction(magnitude: float, rng: np.random.Generator) -> dict[str, float]:
    angle_rad = rng.uniform(-np.pi, np.pi)
    return {"x": magnitude * np.cos(angle_rad), "y": magnitude * np.sin(angle_rad)}


def _grow_both(robot: Robot, p: dict[str, float]) -> Robot:
    radius_m = robot.nominal_radius_m * (1 + p["e"])
    return replace(robot, radius_right_m=radius_m, radius_left_m=radius_m)


def _grow_right_shrink_left(robot: Robot, p: dict[str, float]) -> Robot:
    """Make wheels that turn equally fast roll on a circle of the wanted curvature, the mean radius being nominal."""
    half = 0.5 * p["curvature"] * robot.nominal_track_m
    return replace(
        robot,
        radius_right_m=robot.nominal_radius_m * (1 + half),
        radius_left_m=robot.nominal_radius_m * (1 - half),
    )


CAUSES: dict[str, Cause] = {
    "wheel_scale": Cause(0.005, 0.02, _either_sign("e"), _grow_both),
    "unequal_wheels": Cause(0.003, 0.015, _either_sign("curvature"), _grow_right_shrink_left),
    "wheelbase": Cause(
        0.01,
        0.04,
        _either_sign("e"),
        lambda robot, p: replace(robot, track_m=robot.nominal_track_m * (1 + p["e"])),
    ),
    "gyro_bias": Cause(
        0.002,
        0.01,
        _either_sign("bias"),
        lambda robot, p: replace(robot, gyro_bias_radps=p["bias"]),
        yaw_from="gyro",
    ),
    # A tyre can only yield to the side it is pushed to: this one has no negative.
    "side_slip": Cause(
        0.01,
        0.05,
        lambda magnitude, _: {"k": magnitude},
        lambda robot, p: replace(robot, lateral_creep_s=p["k"]),
    ),
    "time_offset": Cause(
        0.02,
        0.1,
        _either_sign("offset"),
        lambda robot, p: replace(robot, odom_clock_offset_s=p["offset"]),
    ),
    "lever_arm": Cause(
        0.02,
        0.08,
        _any_direction,
        lambda robot, p: replace(robot, marker_xyt=(p["x"], p["y"], 0.0)),
    ),
    "mount_yaw": Cause(
        np.radians(1.0),
        np.radians(4.0),
        _either_sign("yaw"),
        lambda robot, p: replace(robot, marker_xyt=(0.0, 0.0, p["yaw"])),
    ),
}


def draw_parameters(cause: str, size: float, rng: np.random.Generator) -> dict[str, float]:
    """Draw the parameters of a cause: magnitude log-uniform over its range times `size`, sign at random.

    Parameters
    ----------
    cause : str
        A key of `CAUSES`.
    size : float
        Multiplies the magnitude; 1 is the realistic medium.
    """
    flaw = CAUSES[cause]
    magnitude = size * float(np.exp(rng.uniform(np.log(flaw.low), np.log(flaw.high))))
    return {name: float(value) for name, value in flaw.draw(magnitude, rng).items()}

"""Kinematics: motion of the body from wheel angles, with creep, slip and the effective track."""

from dataclasses import dataclass

import numpy as np

from odomcorrupt.simulation.drivetrain import turn_wheels
from odomcorrupt.simulation.planar import add_up_steps
from odomcorrupt.simulation.robot import Robot
from odomcorrupt.simulation.streams import Streams, gauss_markov_noise
from odomcorrupt.simulation.tyres import creep_sideways, hold, lose_by_place, roll, yield_along


@dataclass(frozen=True, slots=True)
class Drive:
    """True motion on a fine time grid.

    grid_s : (n,) true time, s
    angle_rad : (n, 2) right and left motor angle at the wheels' axles, rad
    true_xyt : (n, 3) pose of the base (midway between the wheels) relative to the start; m, m, unwrapped rad
    start_xyt : (3,) start pose in the truth frame; m, m, rad
    """

    grid_s: np.ndarray
    angle_rad: np.ndarray
    true_xyt: np.ndarray
    start_xyt: np.ndarray


@dataclass(frozen=True, slots=True)
class _Steps:
    """Body steps of constant twist: forward and left, m, and turn, rad; shape (n,) each."""

    forward_m: np.ndarray
    left_m: np.ndarray
    turn_rad: np.ndarray


def drive(
    grid_s: np.ndarray, angle_rad: np.ndarray, robot: Robot, creep: float, streams: Streams, start_xyt: np.ndarray
) -> Drive:
    """Return the true motion of the body, from rest at the origin.

    grid_s : (n,) evenly spaced true time, s
    angle_rad : (n, 2) right and left motor angle at the wheels' axles, rad
    start_xyt : (3,) pose of that origin in the truth frame; m, m, rad
    """
    step_s = grid_s[1] - grid_s[0]
    wheel_rad = turn_wheels(angle_rad, robot)
    rim_mps = np.diff(wheel_rad, axis=0) * (robot.nominal_radius_m / step_s)
    travel_m = hold(roll(wheel_rad, step_s, robot, creep, streams), rim_mps, step_s, robot, streams)
    steps = _carry(travel_m, rim_mps, step_s, robot, streams, start_xyt)
    if robot.floor.slippery:
        rolled_m = 0.5 * (travel_m[:, 0] + travel_m[:, 1])
        drift = steps.forward_m - rolled_m + 1j * steps.left_m
        travel_m = lose_by_place(travel_m, drift, robot, robot.floor.slippery, start_xyt)
        steps = _carry(travel_m, rim_mps, step_s, robot, streams, start_xyt)
    return Drive(grid_s, angle_rad, add_up_steps(steps.forward_m, steps.left_m, steps.turn_rad), start_xyt)


def _carry(
    travel_m: np.ndarray, rim_mps: np.ndarray, step_s: float, robot: Robot, streams: Streams, start_xyt: np.ndarray
) -> _Steps:
    rolled_m = 0.5 * (travel_m[:, 0] + travel_m[:, 1])
    turn_rad = _turn(travel_m[:, 0] - travel_m[:, 1], rim_mps[:, 0] - rim_mps[:, 1], step_s, robot, streams)
    forward_m = yield_along(rolled_m, 0.5 * (rim_mps[:, 0] + rim_mps[:, 1]), step_s, robot)
    for i, (sigma, tau_s) in enumerate(robot.floor.uneven):
        forward_m = forward_m * (
            1.0 + gauss_markov_noise(sigma, tau_s, step_s, len(forward_m), streams.open(f"uneven {i}"))
        )
    left_m = creep_sideways(forward_m / step_s, turn_rad / step_s, step_s, robot)
    if robot.rotation_centre_behind_m != 0.0:
        left_m = left_m + robot.rotation_centre_behind_m * turn_rad
    if robot.floor.downhill or robot.floor.grain:
        heading_rad = start_xyt[2] + np.cumsum(turn_rad) - 0.5 * turn_rad
        aside = sum(robot.floor.downhill) * np.exp(-1j * heading_rad)
        aside = aside + 1j * robot.floor.grain * np.sin(2.0 * (robot.floor.grain_from_rad - heading_rad))
        forward_m, left_m = forward_m + aside.real * np.abs(rolled_m), left_m + aside.imag * np.abs(rolled_m)
    return _Steps(forward_m, left_m, turn_rad)


def _turn(apart_m: np.ndarray, apart_mps: np.ndarray, step_s: float, robot: Robot, streams: Streams) -> np.ndarray:
    """Return the turn (n,), rad, of the body for a travel difference right minus left (n,), m, and the effective track.

    The effective track depends on load, scrub and floor. Direction and speed of the turn are those of the wheels
    (`apart_mps`), since random creep shifts no load.
    """
    turn_rad = apart_m / robot.track_m
    if robot.lean != 0.0:
        turn_rad = turn_rad * (1.0 + robot.lean * np.sign(apart_mps))
    if robot.scrub_s != 0.0:
        turn_rad = turn_rad / (1.0 + robot.scrub_s * np.abs(apart_mps) / robot.track_m)
    for i, (sigma, tau_s) in enumerate(robot.play_of_track):
        turn_rad = turn_rad * (
            1.0 + gauss_markov_noise(sigma, tau_s, step_s, len(turn_rad), streams.open(f"play of track {i}"))
        )
    return np.asarray(turn_rad)

"""One recording from a seed: all layers in a row."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from odomcorrupt.simulation.commands import Commands, obey
from odomcorrupt.simulation.drivetrain import wheel_angles
from odomcorrupt.simulation.encoders import Rig, reckon
from odomcorrupt.simulation.fault_draws import draw_flaw, is_placed, names_of, source_of_turns, spoil
from odomcorrupt.simulation.kinematics import drive
from odomcorrupt.simulation.planar import add_up_steps
from odomcorrupt.simulation.record import SimulatedRun, record
from odomcorrupt.simulation.robot import build_robot
from odomcorrupt.simulation.routes import ROUTES, Segment, follow
from odomcorrupt.simulation.streams import Streams, stream
from odomcorrupt.simulation.tracker import TRACKERS, Tracker, dock, watch

STEP_S = 0.002
DAY_S = 600.0
"""How long a round is considered when a flaw gets its place on it."""


def simulate(
    seed: int,
    cause: str | Sequence[str] | None,
    *,
    duration_s: float = 600.0,
    size: float = 1.0,
    truth: str | Tracker = "mocap",
    parameters: Mapping[str, Any] | None = None,
    route: str | Sequence[Segment] | Commands | None = None,
    rig: Rig | None = None,
    yaw_from: str | None = None,
    robot_seed: int | None = None,
    drive_type: str = "differential",
    at_dock: bool | None = None,
    home: str | None = None,
) -> SimulatedRun:
    """Drive a robot with one flaw, several or none, and record it.

    Every layer draws from its own stream of the seed, so runs that differ in `cause` share robot, drive and noise.

    Parameters
    ----------
    seed : int
        Seed of the drive and all noise.
    cause : str, sequence of str, or None
        Keys of `CAUSES` or `OUTSIDE`; None for a flawless robot.
    duration_s : float
        Length, s.
    size : float
        Multiplies the drawn magnitude of the flaw.
    truth : {"mocap", "rtk"} or Tracker
        Who watches.
    parameters : mapping, optional
        Parameters of the flaw instead of drawn ones; where `cause` is a sequence, by its names.
    route : str, sequence of Segment, or Commands, optional
        A key of `ROUTES`, manoeuvres, or speed commands, instead of a random office drive.
    rig : Rig, optional
        Electronics and floor.
    yaw_from : {"encoders", "gyro"}, optional
        The driver's source of turns; by default what the cause needs. See `simulate_without`.
    robot_seed : int, optional
        Seed of the robot and its flaw, to meet the same robot in several drives; by default `seed`.
    drive_type : {"differential", "skid"}
        Kind of machine.
    at_dock : bool, optional
        Begin where the robot's own seed does, not the drive's; by default where a flaw has its place on the floor.
    home : str, optional
        A key of `ROUTES`: the robot's daily round, on which a flaw that has a place was drawn. By default `route`,
        or the office where that is speed commands.
    """
    rig = Rig() if rig is None else rig
    tracker = TRACKERS[truth] if isinstance(truth, str) else truth
    robot_seed = seed if robot_seed is None else robot_seed
    causes = names_of(cause)
    yaw_from = yaw_from or source_of_turns(causes)
    placed = is_placed(causes)
    docked = placed if at_dock is None else at_dock
    start_xyt = dock(stream(robot_seed if docked else seed, "world"))
    grid_s = np.arange(round(duration_s / STEP_S) + 1) * STEP_S

    given: Mapping[str, Any] = {cause: parameters} if isinstance(cause, str) else (parameters or {})
    daily = home or ("office" if isinstance(route, Commands) else route)
    path = _plan(daily, robot_seed, start_xyt) if placed else None
    flaws = {name: draw_flaw(name, size, robot_seed, path, given.get(name)) for name in causes}
    robot = spoil(build_robot(stream(robot_seed, "robot"), drive_type), flaws)

    streams = Streams(seed)
    speeds = _speeds(route, duration_s, seed, grid_s)
    angle_rad = wheel_angles(speeds, STEP_S, robot, rig.motor_ripple, streams.open("motor"))
    driven = drive(grid_s, angle_rad, robot, rig.creep, streams, start_xyt)
    odom = reckon(driven, robot, rig, yaw_from, streams)
    track = watch(driven, robot, tracker, streams)
    return record(odom, track, flaws, robot.nominal_track_m)


def simulate_without(seed: int, cause: str | Sequence[str] | None, **options: Any) -> SimulatedRun:
    """Simulate what `simulate` would with the same arguments, had the robot not the flaw (but the same sensors)."""
    causes = names_of(cause)
    same = {"yaw_from": source_of_turns(causes), "at_dock": is_placed(causes)}
    return simulate(seed, None, **{**same, **options, "parameters": None})


def _speeds(
    route: str | Sequence[Segment] | Commands | None, duration_s: float, seed: int, grid_s: np.ndarray
) -> np.ndarray:
    if isinstance(route, Commands):
        return obey(route, grid_s)
    if route is None or isinstance(route, str):
        route = ROUTES[route or "office"](duration_s, stream(seed, "route"))
    return follow(route, grid_s)


def _plan(route: str | Sequence[Segment] | None, seed: int, start_xyt: np.ndarray) -> np.ndarray:
    """Return where a perfect robot would go in `DAY_S`, every 0.1 s, x + iy in the truth frame, m."""
    grid_s = np.arange(round(DAY_S / 0.1)) * 0.1
    steps = _speeds(route, DAY_S, seed, grid_s) * 0.1
    planned = add_up_steps(steps[:, 0], np.zeros(len(steps)), steps[:, 1])
    way = planned[:, 0] + 1j * planned[:, 1]
    return np.asarray(complex(start_xyt[0], start_xyt[1]) + way * np.exp(1j * start_xyt[2]))

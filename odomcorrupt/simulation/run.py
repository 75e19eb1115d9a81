"""Simulation of a recording from a seed, through all layers."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from odomcorrupt.simulation.encoders import Rig, reckon
from odomcorrupt.simulation.faults import draw_fault, is_placed, names_of, source_of_turns, with_faults
from odomcorrupt.simulation.kinematics import drive, wheel_angles
from odomcorrupt.simulation.planar import add_up_steps
from odomcorrupt.simulation.record import SimulatedRun, record
from odomcorrupt.simulation.robot import build_robot
from odomcorrupt.simulation.routes import ROUTES, Commands, Segment, follow, obey
from odomcorrupt.simulation.streams import Streams, stream
from odomcorrupt.simulation.tracker import TRACKERS, Tracker, dock, watch

STEP_S = 0.002
DAY_S = 600.0
"""Duration of the usual route along which the place of a fault is drawn, s."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """Drive, tracker and size of the fault of a simulated recording.

    duration_s : length, s
    size : factor on the drawn magnitude of the fault
    truth : "mocap", "rtk" or a `Tracker`: source of the truth
    parameters : parameters of the fault instead of drawn ones; for several faults, by their names
    route : a key of `ROUTES`, manoeuvres, or speed commands, instead of a random office drive
    rig : electronics and floor
    yaw_from : "encoders" or "gyro": the odometry's source of turns; by default one with which the fault shows. See
        `simulate_without`
    robot_seed : seed of the robot and its fault, for several drives of one robot; by default that of the drive
    drive_type : "differential" or "skid": wheel layout
    at_dock : whether the start pose depends on the robot's seed, not the drive's; by default if a fault has a place
    home : a key of `ROUTES`: the usual route, along which the place of a fault is drawn. By default `route`, or the
        office for speed commands
    """

    duration_s: float = 600.0
    size: float = 1.0
    truth: str | Tracker = "mocap"
    parameters: Mapping[str, Any] | None = None
    route: str | Sequence[Segment] | Commands | None = None
    rig: Rig = field(default_factory=Rig)
    yaw_from: str | None = None
    robot_seed: int | None = None
    drive_type: str = "differential"
    at_dock: bool | None = None
    home: str | None = None


def simulate(
    seed: int, cause: str | Sequence[str] | None, scenario: Scenario | None = None, **changes: Any
) -> SimulatedRun:
    """Return a simulated recording of a robot with one fault, several or none.

    Every layer has its own random stream, so runs that differ only in `cause` share robot, drive and noise.

    Parameters
    ----------
    seed : int
        Seed of the drive and all noise.
    cause : str, sequence of str, or None
        Keys of `CAUSES` or `OUTSIDE`; None for a robot without faults.
    scenario : Scenario, optional
        Drive, tracker and size of the fault.
    **changes
        Fields of the scenario that differ.
    """
    what = replace(scenario or Scenario(), **changes)
    tracker = TRACKERS[what.truth] if isinstance(what.truth, str) else what.truth
    robot_seed = seed if what.robot_seed is None else what.robot_seed
    causes = names_of(cause)
    yaw_from = what.yaw_from or source_of_turns(causes)
    placed = is_placed(causes)
    docked = placed if what.at_dock is None else what.at_dock
    start_xyt = dock(stream(robot_seed if docked else seed, "world"))
    grid_s = np.arange(round(what.duration_s / STEP_S) + 1) * STEP_S

    given: Mapping[str, Any] = {cause: what.parameters} if isinstance(cause, str) else (what.parameters or {})
    daily = what.home or ("office" if isinstance(what.route, Commands) else what.route)
    path = _plan(daily, robot_seed, start_xyt) if placed else None
    faults = {name: draw_fault(name, what.size, robot_seed, path, given.get(name)) for name in causes}
    robot = with_faults(build_robot(stream(robot_seed, "robot"), what.drive_type), faults)

    streams = Streams(seed)
    speeds = _speeds(what.route, what.duration_s, seed, grid_s)
    angle_rad = wheel_angles(speeds, STEP_S, robot, what.rig.motor_ripple, streams.open("motor"))
    driven = drive(grid_s, angle_rad, robot, what.rig.creep, streams, start_xyt)
    odom = reckon(driven, robot, what.rig, yaw_from, streams)
    track = watch(driven, robot, tracker, streams)
    return record(odom, track, faults, robot.nominal_track_m)


def simulate_without(seed: int, cause: str | Sequence[str] | None, **options: Any) -> SimulatedRun:
    """Return the recording of `simulate` for the same arguments and sensors, but without the fault."""
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
    """Return the path of a perfect robot over `DAY_S`, every 0.1 s, x + iy in the truth frame, m."""
    grid_s = np.arange(round(DAY_S / 0.1)) * 0.1
    steps = _speeds(route, DAY_S, seed, grid_s) * 0.1
    planned = add_up_steps(steps[:, 0], np.zeros(len(steps)), steps[:, 1])
    way = planned[:, 0] + 1j * planned[:, 1]
    return np.asarray(complex(start_xyt[0], start_xyt[1]) + way * np.exp(1j * start_xyt[2]))

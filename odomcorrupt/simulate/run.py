"""One recording from a seed: all layers in a row."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from odomcorrupt.simulate.causes import CAUSES, draw_parameters
from odomcorrupt.simulate.contact import drive
from odomcorrupt.simulate.encoders import Rig, reckon
from odomcorrupt.simulate.motor import wheel_angles
from odomcorrupt.simulate.planar import wrap
from odomcorrupt.simulate.robot import build_robot
from odomcorrupt.simulate.route import Segment, draw_route, follow
from odomcorrupt.simulate.streams import stream
from odomcorrupt.simulate.tracker import TRACKERS, Tracker, watch

STEP_S = 0.002
EPOCH_NS = 1_750_000_000_000_000_000


@dataclass(frozen=True, slots=True)
class SimulatedRun:
    """A recording and its secret. Poses are m, m, rad wrapped to (-pi, pi]; twists m/s, m/s, rad/s in the body.

    Attributes
    ----------
    odom_stamps_ns : ndarray of int64, shape (n,)
        By the odometry's clock.
    odom_xyt, odom_twist : ndarray, shape (n, 3)
        Base in the odometry frame; mean twist since the sample before.
    truth_stamps_ns : ndarray of int64, shape (m,)
        By the true clock.
    truth_xyt : ndarray, shape (m, 3)
        Tracked frame in the world.
    answer : dict
        ``cause`` (str or None), ``parameters`` (dict of float, names and units as in the effects' table) and
        ``track_m`` (nominal).
    track_m : float
        Nominal track, which a user would know; m.
    """

    odom_stamps_ns: np.ndarray
    odom_xyt: np.ndarray
    odom_twist: np.ndarray
    truth_stamps_ns: np.ndarray
    truth_xyt: np.ndarray
    answer: dict
    track_m: float


def simulate(
    seed: int,
    cause: str | None,
    *,
    duration_s: float = 600.0,
    size: float = 1.0,
    truth: str | Tracker = "mocap",
    parameters: Mapping[str, float] | None = None,
    route: Sequence[Segment] | None = None,
    rig: Rig | None = None,
    yaw_from: str | None = None,
    robot_seed: int | None = None,
) -> SimulatedRun:
    """Drive a robot with one flaw, or none, and record it.

    Every layer draws from its own stream of the seed, so runs that differ in `cause` share robot, drive and noise.

    Parameters
    ----------
    seed : int
        Seed of the drive and all noise.
    cause : str or None
        A key of `CAUSES`; None for a flawless robot.
    duration_s : float
        Length, s.
    size : float
        Multiplies the drawn magnitude of the flaw.
    truth : {"mocap", "rtk"} or Tracker
        Who watches.
    parameters : mapping, optional
        Parameters of the flaw instead of drawn ones.
    route : sequence of Segment, optional
        Manoeuvres instead of a random office drive.
    rig : Rig, optional
        Electronics and floor.
    yaw_from : {"encoders", "gyro"}, optional
        The driver's source of turns; by default what the cause needs. See `simulate_without`.
    robot_seed : int, optional
        Seed of the robot and its flaw, to meet the same robot in several drives; by default `seed`.
    """
    rig = Rig() if rig is None else rig
    tracker = TRACKERS[truth] if isinstance(truth, str) else truth
    robot_seed = seed if robot_seed is None else robot_seed
    robot = build_robot(stream(robot_seed, "robot"))
    drawn: dict[str, float] = {}
    if cause is not None:
        drawn = dict(parameters or draw_parameters(cause, size, stream(robot_seed, f"cause {cause}")))
        robot = CAUSES[cause].spoil(robot, drawn)
        yaw_from = yaw_from or CAUSES[cause].yaw_from

    grid_s = np.arange(round(duration_s / STEP_S) + 1) * STEP_S
    command = follow(route or draw_route(duration_s, stream(seed, "route")), grid_s)
    angle_rad = wheel_angles(command, STEP_S, robot, rig.motor_ripple, stream(seed, "motor"))
    driven = drive(grid_s, angle_rad, robot, rig.creep, stream(seed, "contact"))
    own = {name: stream(seed, name) for name in ("odom_clock", "encoders", "gyro")}
    odom = reckon(driven, robot, rig, yaw_from or "encoders", own)
    outside = {name: stream(seed, name) for name in ("world", "tracker_clock", "tracker", "dropouts")}
    track = watch(driven, robot, tracker, outside)
    return SimulatedRun(
        odom_stamps_ns=_to_ns(odom.stamps_s),
        odom_xyt=_wrapped(odom.xyt),
        odom_twist=odom.twist,
        truth_stamps_ns=_to_ns(track.stamps_s),
        truth_xyt=_wrapped(track.xyt),
        answer={"cause": cause, "parameters": drawn, "track_m": robot.nominal_track_m},
        track_m=robot.nominal_track_m,
    )


def simulate_without(seed: int, cause: str | None, **options: object) -> SimulatedRun:
    """Simulate what `simulate` would with the same arguments, had the robot not the flaw (but the same sensors)."""
    yaw_from = "encoders" if cause is None else CAUSES[cause].yaw_from
    return simulate(seed, None, **{"yaw_from": yaw_from, **options, "parameters": None})


def _to_ns(times_s: np.ndarray) -> np.ndarray:
    return EPOCH_NS + np.rint(times_s * 1e9).astype(np.int64)


def _wrapped(xyt: np.ndarray) -> np.ndarray:
    return np.column_stack((xyt[:, :2], wrap(xyt[:, 2])))

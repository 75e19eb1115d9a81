"""One recording of the body: commands in, contact forces in between, odometry and truth out."""

from collections.abc import Sequence
from functools import partial

import mujoco
import numpy as np

from mujocosim.body import RADIUS_M, TRACK_M, Body, Standing, build
from mujocosim.causes import CAUSES
from odomcorrupt.simulation import ROUTES, TRACKERS, Rig, Segment, SimulatedRun, Tracker
from odomcorrupt.simulation.robot import Drive, Robot, stream
from odomcorrupt.simulation.routes import follow
from odomcorrupt.simulation.run import record
from odomcorrupt.simulation.sensors import reckon, watch

CONTROL_S = 0.01
STEPS = 10
TRIM_PER_S = 2.0
GRIP = 0.9
DRIVER = Robot(
    nominal_radius_m=RADIUS_M,
    nominal_track_m=TRACK_M,
    motor_lag_s=0.0,
    travel_noise_m_per_sqrt_m=0.0,
    radius_right_m=RADIUS_M,
    radius_left_m=RADIUS_M,
    track_m=TRACK_M,
)


def simulate_body(
    seed: int,
    cause: str | None,
    *,
    duration_s: float = 60.0,
    truth: str | Tracker = "mocap",
    parameters: dict[str, float] | None = None,
    route: str | Sequence[Segment] = "office",
    rig: Rig | None = None,
    yaw_from: str = "encoders",
) -> SimulatedRun:
    """Drive the body with one flaw, or none, and record it.

    The answer's ``cause`` and ``causes`` are names of the effects' table where it has one; ``body`` says what was
    built (name and parameters), and ``rolling_m`` the true rolling radii (right, left), m. The truth frame is where
    the body began.
    """
    drawn: dict[str, float] = {}
    body, standing = Body(), None
    if cause is not None:
        drawn = {k: float(v) for k, v in CAUSES[cause].draw(stream(seed, f"body {cause}")).items()} | (parameters or {})
        body = CAUSES[cause].spoil(body, drawn)
    standing = build(body)
    if isinstance(route, str):
        route = ROUTES[route](duration_s, stream(seed, "route"))
    grid_s = np.arange(round(duration_s / CONTROL_S) + 1) * CONTROL_S
    driven = _drive(standing, body, follow(route, grid_s), grid_s)
    streams = partial(stream, seed)
    odom = reckon(driven, DRIVER, rig or Rig(), yaw_from, streams)
    track = watch(driven, DRIVER, TRACKERS[truth] if isinstance(truth, str) else truth, streams)
    flaws = CAUSES[cause].answer(standing, drawn) if cause else {}
    run = record(odom, track, flaws, TRACK_M)
    run.answer.update(body={"name": cause, "parameters": drawn}, rolling_m=standing.rolling_m.tolist())
    return run


def _drive(standing: Standing, body: Body, speeds: np.ndarray, grid_s: np.ndarray) -> Drive:
    """Step the body through commanded speeds (n, 2), m/s and rad/s, with a velocity servo and a slow trim."""
    model, data = standing.model, standing.data
    apart = 0.5 * TRACK_M * speeds[:, 1]
    wanted = np.column_stack((speeds[:, 0] + apart, speeds[:, 0] - apart)) / RADIUS_M
    joints = [model.joint(name).qposadr[0] for name in ("right", "left")]
    rates = [model.joint(name).dofadr[0] for name in ("right", "left")]
    wheels = [model.geom(name).id for name in ("right", "left")]
    states = np.empty((len(grid_s), 5 + 4))
    trim = np.zeros(2)
    for i, target in enumerate(wanted):
        states[i, :2], states[i, 2:4] = data.qpos[joints], data.qpos[:2]
        states[i, 4:8] = data.qpos[3:7]
        trim += TRIM_PER_S * CONTROL_S * (target - data.qvel[rates])
        data.ctrl[:] = target + trim
        if body.patch is not None:
            _slip(model, data, wheels, body.patch)
        mujoco.mj_step(model, data, nstep=STEPS)
    w, x, y, z = states[:, 4:8].T
    heading = np.unwrap(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    start = np.array([states[0, 2], states[0, 3], heading[0]])
    place = (states[:, 2] - start[0] + 1j * (states[:, 3] - start[1])) * np.exp(-1j * heading[0])
    true_xyt = np.column_stack((place.real, place.imag, heading - heading[0]))
    return Drive(grid_s, states[:, :2] - states[0, :2], true_xyt, np.zeros(3))


def _slip(
    model: mujoco.MjModel, data: mujoco.MjData, wheels: list[int], patch: tuple[float, float, float, float]
) -> None:
    """Give each wheel the friction of where it stands."""
    x, y, radius_m, friction = patch
    for wheel in wheels:
        wx, wy = data.geom_xpos[wheel, :2]
        model.geom_friction[wheel, 0] = friction if np.hypot(wx - x, wy - y) < radius_m else GRIP

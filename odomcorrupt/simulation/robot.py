"""A robot at wheel level: its geometry, and the motion of its body and wheels."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from scipy.signal import lfilter


@dataclass(frozen=True, slots=True)
class Slippery:
    """A place where the fraction `slip` of the travel is lost: a round patch, or a strip without end."""

    middle: complex
    """A point x + iy on the centre line, m."""
    half_m: float
    """Radius, or half the width."""
    slip: float
    by_wheel: bool
    """Whether each wheel slips by its own position; otherwise both slip by that of the axle's middle."""
    strip_rad: float | None = None
    """Direction of a strip; None for a round patch."""

    def holds(self, place: complex) -> bool:
        """Return whether a point (x + iy, m) is inside."""
        away = place - self.middle
        across = away if self.strip_rad is None else (away * np.exp(-1j * self.strip_rad)).imag
        return bool(abs(across) < self.half_m)


@dataclass(frozen=True, slots=True)
class Bursts:
    """Short losses of grip: rate (1/s), mean fraction of the travel lost, and duration (s)."""

    rate_hz: float
    slip: float
    duration_s: float


@dataclass(frozen=True, slots=True)
class Floor:
    """The floor; the default is level, dry and uniform."""

    slippery: tuple[Slippery, ...] = ()
    bursts: tuple[Bursts, ...] = ()
    downhill: tuple[complex, ...] = ()
    """Creep per metre rolled, as vectors x + iy: a tyre yields sideways only while it rolls."""
    grain: float = 0.0
    """Sideways creep per metre rolled at 45 degrees to the carpet's ribs: wheels tend to roll along them."""
    grain_from_rad: float = 0.0
    """Direction of the ribs."""
    uneven: tuple[tuple[float, float], ...] = ()
    """Gauss-Markov variation of the travel per metre rolled: (sigma, correlation time in s)."""
    jolts_inverse_dof: float = 0.0
    """Weight of the tails of the random creep: 1 / degrees of freedom of Student's t."""
    grip_mps: float = np.inf
    """Rim speed above which a wheel loses grip."""
    grip_slip: float = 0.0
    """Fraction of the travel lost above `grip_mps`."""
    braking_mps2: float = np.inf
    """Deceleration above which a braking wheel slides."""
    braking_slip: float = 0.0
    """Fraction of the travel gained while sliding."""


DRIVE_TYPES = ("differential", "skid")


@dataclass(frozen=True, slots=True)
class Robot:
    """A machine with one driven wheel, or row of wheels, on each side; its odometry uses the nominal dimensions only.

    New physics is a new field that has no effect at its default, read by its layer of the simulator.
    """

    nominal_radius_m: float
    nominal_track_m: float
    motor_lag_s: float
    travel_noise_m_per_sqrt_m: float
    radius_right_m: float
    radius_left_m: float
    track_m: float
    scrub_arm_m: float = 0.0
    """Sideways travel of the tread per radian of turn: wheels in rows scrub, and creep at random as a result."""

    # tyres
    lateral_creep_s: float = 0.0
    """Mass over lateral creep coefficient of the tyres (N per m/s of sideways speed); 0 for a rigid tyre."""
    traction_s2_per_m: float = 0.0
    """Mass over longitudinal slip stiffness (N per unit of slip ratio); 0 for a rigid tyre."""
    growth_s_per_m: float = 0.0
    """Relative growth of a wheel's radius per m/s of rim speed."""
    warming_per_s: float = 0.0
    """Relative growth of both radii per second since the start."""
    eccentricity: float = 0.0
    """Distance of the right axle from the middle of its wheel, over the radius."""
    eccentric_from_rad: float = 0.0
    load_shift_s: float = np.inf
    """Time at which the load slides to one side, s after the start."""
    load_squeeze: float = 0.0
    """Relative loss of the right radius from that time on (and gain of the left)."""

    # turning of the body
    rotation_centre_behind_m: float = 0.0
    """Distance of the centre of rotation behind the base frame."""
    lean: float = 0.0
    """Relative loss of effective track in left turns, and gain in right ones (contact patches move under the load)."""
    scrub_s: float = 0.0
    """Relative growth of the effective track per rad/s of turn rate."""
    play_of_track: tuple[tuple[float, float], ...] = ()
    """Gauss-Markov variation of the effective track: (sigma, correlation time in s)."""
    play_of_rims: tuple[tuple[float, float], ...] = ()
    """Gauss-Markov turn per way driven: (sigma in rad/m, correlation time in s)."""

    # gear, encoders and heading sensor
    gear_play_m: float = 0.0
    """Play between motor (with the encoder) and wheel, at the rim."""
    tick_travel_m: float = 0.0
    """Travel per tick at the rim, instead of the rig's resolution."""
    lost_cycles: float = 0.0
    """Fraction of the driver's cycles whose ticks (and turn) are lost in transmission."""
    gyro_bias_radps: float = 0.0
    gyro_scale: float = 0.0
    gyro_walk_radps_per_sqrt_s: float = 0.0
    hard_iron_rad: float = 0.0
    """Amplitude of the compass error of a heading sensor with a magnetometer."""
    hard_iron_from_rad: float = 0.0
    """World heading at which this error crosses zero upwards."""

    # tracked marker, and clocks
    marker_xyt: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Pose of the tracked frame in the base frame; m, m, rad."""
    odom_clock_offset_s: float = 0.0
    odom_clock_rate: float = 0.0
    """Odometry clock's seconds per true second, minus 1."""

    floor: Floor = field(default_factory=Floor)
    """Floor under the robot."""


def build_robot(rng: np.random.Generator, drive_type: str = "differential") -> Robot:
    """Return a random robot without faults: its true wheels and track are the nominal ones.

    The nominal track of a skid-steered robot is its effective one, larger than the distance of its wheels; its tread
    is still dragged in turns.

    drive_type : "differential" or "skid": one wheel on each side and castors, or a row of wheels on each side
    """
    radius_m = round(rng.uniform(0.07, 0.12), 3)
    track_m = round(rng.uniform(0.32, 0.5), 3)
    robot = Robot(
        nominal_radius_m=radius_m,
        nominal_track_m=track_m,
        motor_lag_s=rng.uniform(0.06, 0.15),
        travel_noise_m_per_sqrt_m=rng.uniform(0.001, 0.003),
        radius_right_m=radius_m,
        radius_left_m=radius_m,
        track_m=track_m,
    )
    if drive_type == "differential":
        return robot
    wider_m = round(track_m * rng.uniform(1.3, 2.0), 3)
    return replace(robot, nominal_track_m=wider_m, track_m=wider_m, scrub_arm_m=rng.uniform(0.1, 0.25))


def stream(seed: int, layer: str) -> np.random.Generator:
    """Return the generator of one layer of one run.

    seed : non-negative seed of the run
    layer : name of the layer, such as ``"encoders"``
    """
    return np.random.default_rng([seed, zlib.crc32(layer.encode())])


Streams: TypeAlias = Callable[[str], np.random.Generator]
"""The streams of one run by layer. Opening a layer restarts its stream, so each is opened once."""


def gauss_markov_noise(sigma: float, tau_s: float, step_s: float, n: int, rng: np.random.Generator) -> np.ndarray:
    """Return a stationary Gauss-Markov sequence of deviation `sigma` and correlation time `tau_s`, shape (n,)."""
    stay = np.exp(-step_s / tau_s)
    draws = rng.normal(size=n)
    draws[1:] *= np.sqrt(1.0 - stay**2)
    return np.asarray(sigma * lfilter([1.0], [1.0, -stay], draws))


def add_up_steps(forward_m: np.ndarray, left_m: np.ndarray, turn_rad: np.ndarray) -> np.ndarray:
    """Return the poses (n + 1, 3) reached from the origin by steps of constant body twist, each an exact circular arc.

    forward_m, left_m : (n,) arc lengths along the body's x and y axes, m
    turn_rad : (n,) heading change of each step, rad
    """
    heading = np.concatenate(([0.0], np.cumsum(turn_rad)))
    midway = heading[:-1] + 0.5 * turn_rad
    chord = np.sinc(turn_rad / (2 * np.pi)) * (forward_m + 1j * left_m) * np.exp(1j * midway)
    place = np.concatenate(([0.0], np.cumsum(chord)))
    return np.column_stack((place.real, place.imag, heading))


def attach(pose_xyt: np.ndarray, mounted_xyt: tuple[float, float, float]) -> np.ndarray:
    """Return the poses (n, 3) of a frame fixed to a moving body; m, m, rad.

    pose_xyt : (n, 3) poses of the body; m, m, rad
    mounted_xyt : the attached frame seen from the body; m, m, rad
    """
    x, y, yaw = mounted_xyt
    place = pose_xyt[:, 0] + 1j * pose_xyt[:, 1] + (x + 1j * y) * np.exp(1j * pose_xyt[:, 2])
    return np.column_stack((place.real, place.imag, pose_xyt[:, 2] + yaw))


def sample(grid_s: np.ndarray, values: np.ndarray, at_s: np.ndarray) -> np.ndarray:
    """Return the columns (m, c) of a finely sampled signal interpolated at other times (headings must be unwrapped).

    grid_s : (n,) increasing times, s
    values : (n, c) the signal, any unit
    at_s : (m,) times wanted, s
    """
    return np.column_stack([np.interp(at_s, grid_s, column) for column in values.T])


def wrap(angle_rad: np.ndarray) -> np.ndarray:
    """Return angles wrapped to (-pi, pi], rad."""
    return np.pi - (np.pi - angle_rad) % (2 * np.pi)


def wheel_angles(
    command: np.ndarray, step_s: float, robot: Robot, ripple: float, rng: np.random.Generator
) -> np.ndarray:
    """Return the motor angles (n, 2) over time, right and left, at the wheels' axles, rad.

    The motor controller, like the odometry driver, uses nominal dimensions: the angles do not depend on the faults.

    command : (n, 2) forward speed in m/s, turn rate in rad/s
    ripple : relative speed ripple by cogging; the controller's hunting is proportional to it. 0 is a perfect motor
    """
    apart_mps = 0.5 * robot.nominal_track_m * command[:, 1]
    wanted_mps = np.column_stack((command[:, 0] + apart_mps, command[:, 0] - apart_mps))
    keep = np.exp(-step_s / robot.motor_lag_s)
    rim_mps = lfilter([1.0 - keep], [1.0, -keep], wanted_mps, axis=0)

    # a speed controller hunts by 0.4 m/s per ripple, correlated over 0.25 s; the motor cogs seven times a turn
    stay = np.exp(-step_s / 0.25)
    hunting = lfilter([np.sqrt(1.0 - stay**2)], [1.0, -stay], rng.normal(size=rim_mps.shape), axis=0)
    hunting_mps = 0.4 * hunting * np.abs(rim_mps) / (np.abs(rim_mps) + 0.05)
    cog_rad = 7 * np.cumsum(rim_mps, axis=0) * (step_s / robot.nominal_radius_m)
    cogging_mps = rim_mps * np.sin(cog_rad + rng.uniform(0.0, 2.0 * np.pi, size=2))
    turning_mps = rim_mps + ripple * (cogging_mps + hunting_mps)
    return np.asarray(np.cumsum(turning_mps, axis=0) * (step_s / robot.nominal_radius_m))


def turn_wheels(motor_rad: np.ndarray, robot: Robot) -> np.ndarray:
    """Return the wheel angles (n, 2) for given motor angles, with gear backlash, rad.

    After a reversal a motor crosses the gap before it moves its wheel. Initially the forward flanks touch.

    motor_rad : (n, 2) right and left motor angle at the wheel's axle, rad
    """
    if robot.gear_play_m == 0.0:
        return motor_rad
    gap_rad = robot.gear_play_m / robot.nominal_radius_m
    return np.column_stack([_carried(column.tolist(), gap_rad) for column in motor_rad.T])


def _carried(motor_rad: list[float], gap_rad: float) -> list[float]:
    wheel_rad, turned = motor_rad[0], []
    for pushing in motor_rad:
        wheel_rad = min(max(wheel_rad, pushing), pushing + gap_rad)
        turned.append(wheel_rad)
    return turned


def roll(wheel_rad: np.ndarray, step_s: float, robot: Robot, creep: float, streams: Streams) -> np.ndarray:
    """Return the travel (n, 2), m, of each wheel's contact point per step, right and left, without slip.

    A wheel rolls on its true radius; its contact point creeps at random, with variance proportional to the travel.

    wheel_rad : (n + 1, 2) angle of the right and left wheel, rad
    creep : factor on the robot's random travel (0 for none)
    """
    turned_rad = np.diff(wheel_rad, axis=0)
    rubbed_m = np.abs(turned_rad) * robot.nominal_radius_m
    if robot.scrub_arm_m > 0.0:
        apart_m = np.abs(turned_rad[:, :1] - turned_rad[:, 1:]) * robot.nominal_radius_m
        rubbed_m = rubbed_m + apart_m * (robot.scrub_arm_m / robot.nominal_track_m)
    draws = streams("contact").normal(size=turned_rad.shape)
    noise_m = creep * robot.travel_noise_m_per_sqrt_m * np.sqrt(rubbed_m) * draws
    if robot.floor.jolts_inverse_dof > 0.0:
        noise_m = noise_m * _roughness(len(noise_m), step_s, robot.floor.jolts_inverse_dof, streams)[:, None]
    rolled_m = turned_rad * (robot.radius_right_m, robot.radius_left_m)
    return rolled_m * _radius_now(wheel_rad, step_s, robot) + noise_m


def _radius_now(wheel_rad: np.ndarray, step_s: float, robot: Robot) -> np.ndarray | float:
    """Return the ratios (n, 2) of the radii at each step to their initial values at rest."""
    if robot.growth_s_per_m == robot.warming_per_s == robot.eccentricity == robot.load_squeeze == 0.0:
        return 1.0
    rim_mps = np.abs(np.diff(wheel_rad, axis=0)) * (robot.nominal_radius_m / step_s)
    now_s = np.arange(len(rim_mps)) * step_s
    ratio = (1.0 + robot.growth_s_per_m * rim_mps) * (1.0 + robot.warming_per_s * now_s)[:, None]
    midway_rad = 0.5 * (wheel_rad[1:, 0] + wheel_rad[:-1, 0]) + robot.eccentric_from_rad
    ratio[:, 0] *= 1.0 + robot.eccentricity * np.cos(midway_rad)
    squeeze = robot.load_squeeze * (now_s >= robot.load_shift_s)
    return np.asarray(ratio * np.column_stack((1.0 - squeeze, 1.0 + squeeze)))


def _roughness(n: int, step_s: float, inverse_dof: float, streams: Streams) -> np.ndarray:
    """Return factors (n,) that turn normal draws into Student's t, constant over each section of floor."""
    # duration of constant floor roughness in a floor with heavy-tailed creep, s
    per_jolt = round(0.5 / step_s)
    chi2 = streams("jolts").chisquare(1.0 / inverse_dof, size=n // per_jolt + 1)
    return np.repeat(1.0 / np.sqrt(chi2 * inverse_dof), per_jolt)[:n]


def yield_along(rolled_m: np.ndarray, rim_mps: np.ndarray, step_s: float, robot: Robot) -> np.ndarray:
    """Return the forward travel (n,), m, of the body per step, which lags behind the wheels by longitudinal tyre slip.

    Newton's law with slip stiffness C at rolling speed u: ``m dv/dt = C (u - v) / abs(u)``, both wheels sharing the
    force equally. The result depends on ``m / C`` alone. Slip is computed from the wheels' speed, not from their random
    creep, which moves no load and must not be rectified by that product.

    rolled_m : (n,) forward travel of the wheels per step, m
    rim_mps : (n,) mean rim speed of both wheels
    """
    if robot.traction_s2_per_m == 0.0:
        return rolled_m
    settle_s = robot.traction_s2_per_m * np.abs(rim_mps)
    keep = np.exp(-step_s / np.maximum(settle_s, 1e-9))
    behind_mps, speed_mps = [], 0.0
    for rolling_mps, kept in zip((rolled_m / step_s).tolist(), keep.tolist(), strict=True):
        behind_mps.append(speed_mps - rolling_mps)
        speed_mps = rolling_mps + (speed_mps - rolling_mps) * kept
    return np.asarray(rolled_m + np.array(behind_mps) * settle_s * (1.0 - keep))


def creep_sideways(v_mps: np.ndarray, omega_radps: np.ndarray, step_s: float, robot: Robot) -> np.ndarray:
    """Return the leftward travel (n,), m, of the body per step under centripetal acceleration and lateral tyre force.

    In the body frame ``m (dv_y/dt + v omega) = -c v_y``; the result depends on ``m / c`` alone.

    v_mps, omega_radps : (n,) forward speed and turn rate, constant over each step
    """
    settle_s = robot.lateral_creep_s
    if settle_s == 0.0:
        return np.zeros_like(v_mps)
    pull_mps2 = -v_mps * omega_radps
    keep = np.exp(-step_s / settle_s)
    speed_end_mps = lfilter([settle_s * (1.0 - keep)], [1.0, -keep], pull_mps2)
    speed_start_mps = np.concatenate(([0.0], speed_end_mps[:-1]))
    # d(speed)/dt = pull - speed / settle, integrated over a step and solved for the travel
    return np.asarray(settle_s * (pull_mps2 * step_s - (speed_end_mps - speed_start_mps)))


COARSE = 10
"""Grid steps over which a wheel's position counts as constant (20 ms: less than the length of a contact patch)."""


def lose_by_speed(travel_m: np.ndarray, rim_mps: np.ndarray, step_s: float, floor: Floor) -> np.ndarray:
    """Return the travel of each wheel (n, 2), m, with slip of wheels that are too fast or braked.

    rim_mps : (n, 2) speed at which each wheel turns, at its rim
    """
    speed_mps = np.abs(rim_mps)
    if np.isfinite(floor.grip_mps):
        travel_m = np.where(speed_mps > floor.grip_mps, (1.0 - floor.grip_slip) * travel_m, travel_m)
    if np.isfinite(floor.braking_mps2):
        # time constant of the weight shift in braking, s
        keep = np.exp(-step_s / 0.1)
        felt_mps = lfilter([1.0 - keep], [1.0, -keep], speed_mps.mean(axis=1))
        dragged = -np.gradient(felt_mps, step_s) > floor.braking_mps2
        travel_m = np.where(dragged[:, None], (1.0 + floor.braking_slip) * travel_m, travel_m)
    return travel_m


def lose_by_chance(travel_m: np.ndarray, step_s: float, bursts: Bursts, rng: np.random.Generator) -> np.ndarray:
    """Return the travel of each wheel (n, 2), m, with random bursts of slip.

    Bursts start at random; each wheel loses its own random fraction, between 0 and 1 and of the given mean.

    travel_m : (n, 2) travel of the right and left wheel per step without bursts, m
    """
    steps = len(travel_m)
    lost = np.zeros_like(travel_m)
    for _ in range(rng.poisson(bursts.rate_hz * steps * step_s) if 0.0 < bursts.slip < 1.0 else 0):
        begin = rng.integers(steps)
        end = begin + round(bursts.duration_s * rng.uniform(0.5, 1.5) / step_s)
        slip = rng.beta(2.0 * bursts.slip, 2.0 * (1.0 - bursts.slip), size=2)
        lost[begin:end] = np.maximum(lost[begin:end], slip)
    return travel_m * (1.0 - lost)


def lose_by_place(
    travel_m: np.ndarray, drift: np.ndarray, robot: Robot, slippery: tuple[Slippery, ...], start_xyt: np.ndarray
) -> np.ndarray:
    """Return the travel of each wheel per step (n, 2), m, with slip at slippery places.

    travel_m : (n, 2) travel of the right and left wheel per step, m
    drift : (n,) complex, further motion of the body per step, in its own frame, m
    start_xyt : (3,) start pose of the body in the truth frame; m, m, rad
    """
    edges = np.arange(0, len(travel_m), COARSE)
    blocks_m = np.add.reduceat(travel_m, edges, axis=0).tolist()
    drifts = np.add.reduceat(drift, edges).tolist()
    place, heading_rad = complex(start_xyt[0], start_xyt[1]), float(start_xyt[2])
    keeps = []
    for (right_m, left_m), aside in zip(blocks_m, drifts, strict=True):
        facing = complex(np.cos(heading_rad), np.sin(heading_rad))
        keep_right = keep_left = 1.0
        for patch in slippery:
            arm = 0.5j * robot.track_m * facing * patch.by_wheel
            keep_right *= 1.0 - patch.slip * patch.holds(place - arm)
            keep_left *= 1.0 - patch.slip * patch.holds(place + arm)
        keeps.append((keep_right, keep_left))
        right_m, left_m = keep_right * right_m, keep_left * left_m  # noqa: PLW2901 - the same travel, less the slip
        turn_rad = (right_m - left_m) / robot.track_m
        midway = facing * complex(1.0, 0.5 * turn_rad)
        place += (0.5 * (right_m + left_m) + aside) * midway
        heading_rad += turn_rad
    return np.asarray(travel_m * np.repeat(np.array(keeps), COARSE, axis=0)[: len(travel_m)])


def hold(travel_m: np.ndarray, rim_mps: np.ndarray, step_s: float, robot: Robot, streams: Streams) -> np.ndarray:
    """Return the travel of each wheel (n, 2), m, with slip that does not depend on the place.

    travel_m : (n, 2) travel of the right and left wheel per step without slip, m
    rim_mps : (n, 2) speeds of the rims, m/s
    """
    travel_m = lose_by_speed(travel_m, rim_mps, step_s, robot.floor)
    for i, bursts in enumerate(robot.floor.bursts):
        travel_m = lose_by_chance(travel_m, step_s, bursts, streams(f"bursts {i}"))
    return travel_m


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
    for i, (sigma, tau_s) in enumerate(robot.play_of_rims):
        turn_rad = turn_rad + rolled_m * gauss_markov_noise(
            sigma, tau_s, step_s, len(rolled_m), streams(f"play of rims {i}")
        )
    forward_m = yield_along(rolled_m, 0.5 * (rim_mps[:, 0] + rim_mps[:, 1]), step_s, robot)
    for i, (sigma, tau_s) in enumerate(robot.floor.uneven):
        forward_m = forward_m * (1.0 + gauss_markov_noise(sigma, tau_s, step_s, len(forward_m), streams(f"uneven {i}")))
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
            1.0 + gauss_markov_noise(sigma, tau_s, step_s, len(turn_rad), streams(f"play of track {i}"))
        )
    return np.asarray(turn_rad)

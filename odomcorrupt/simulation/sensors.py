"""Instruments: odometry of encoders or a gyro by dead reckoning, and the ground truth of motion capture or RTK."""

from dataclasses import dataclass

import numpy as np

from odomcorrupt.simulation.robot import Drive, Robot, Streams, add_up_steps, attach, gauss_markov_noise, sample


@dataclass(frozen=True, slots=True)
class Rig:
    """Noise of the robot's electronics, motors and floor contact, independent of its faults."""

    odom_hz: float = 50.0
    sampling_jitter_s: float = 0.001
    stamp_jitter_s: float = 0.0001
    ticks_per_turn: int | None = 4096
    """None for encoders of infinite resolution."""
    gyro_noise_rad_per_sqrt_s: float = 2e-4
    motor_ripple: float = 0.01
    creep: float = 1.0
    """Multiplies the robot's random wheel travel."""


@dataclass(frozen=True, slots=True)
class Odometry:
    """Odometry output: stamps (s, odometry clock), poses (n, 3) in m and rad, body twists (n, 3) in m/s and rad/s."""

    stamps_s: np.ndarray
    xyt: np.ndarray
    twist: np.ndarray


def jittered_times(duration_s: float, rate_hz: float, jitter_s: float, rng: np.random.Generator) -> np.ndarray:
    """Return increasing sampling times (n,) in [0, duration], with a random phase; s.

    duration_s, rate_hz : length of the recording, s, and sampling rate, Hz
    jitter_s : standard deviation of the sampling times, s
    """
    period_s = 1.0 / rate_hz
    times_s = np.arange(rng.uniform(0.1, 0.9) * period_s, duration_s - period_s, period_s)
    return times_s + np.clip(jitter_s * rng.normal(size=times_s.size), -0.1 * period_s, 0.1 * period_s)


def count(angle_rad: np.ndarray, tick_rad: float | None, rng: np.random.Generator) -> np.ndarray:
    """Return wheel angles (n, 2) as measured by an encoder (the last edge passed), rad.

    angle_rad : (n, 2) angles of the right and left wheel, rad
    tick_rad : angle between two edges, rad; None for infinite resolution
    """
    phase = rng.uniform(size=2)
    if tick_rad is None:
        return angle_rad
    return np.floor(angle_rad / tick_rad + phase).astype(np.int64) * tick_rad


def reckon(drive: Drive, robot: Robot, rig: Rig, yaw_from: str, streams: Streams) -> Odometry:
    """Return the odometry of a drive.

    drive : true motion; only the motor angles, and the body's heading through the heading sensor, are measured
    yaw_from : "encoders" or "gyro", the source of the turn of each interval
    """
    clock = streams("odom_clock")
    times_s = jittered_times(drive.grid_s[-1], rig.odom_hz, rig.sampling_jitter_s, clock)
    stamp_noise_s = np.clip(rig.stamp_jitter_s * clock.normal(size=times_s.size), -0.001, 0.001)
    shown_rad = sample(drive.grid_s, drive.angle_rad, times_s)
    tick_rad = None if rig.ticks_per_turn is None else 2 * np.pi / rig.ticks_per_turn
    if robot.tick_travel_m > 0.0:
        tick_rad = robot.tick_travel_m / robot.nominal_radius_m
    rim_m = np.diff(count(shown_rad, tick_rad, streams("encoders")), axis=0) * robot.nominal_radius_m
    forward_m = 0.5 * rim_m.sum(axis=1)
    interval_s = np.diff(times_s)
    if yaw_from == "gyro":
        turn_rad = _felt(drive, times_s, robot, rig, streams)
    else:
        turn_rad = (rim_m[:, 0] - rim_m[:, 1]) / robot.nominal_track_m
    if robot.lost_cycles > 0.0:
        heard = streams("lost cycles").random(interval_s.size) >= robot.lost_cycles
        forward_m, turn_rad = forward_m * heard, turn_rad * heard
    xyt = add_up_steps(forward_m, np.zeros_like(forward_m), turn_rad)
    rate = np.column_stack((forward_m, np.zeros_like(forward_m), turn_rad)) / interval_s[:, None]
    stamps_s = times_s * (1.0 + robot.odom_clock_rate) + robot.odom_clock_offset_s + stamp_noise_s
    return Odometry(stamps_s, xyt, np.vstack((np.zeros(3), rate)))


def _felt(drive: Drive, times_s: np.ndarray, robot: Robot, rig: Rig, streams: Streams) -> np.ndarray:
    """Return the turn of each interval as measured by the heading sensor, rad."""
    interval_s = np.diff(times_s)
    noise_rad = rig.gyro_noise_rad_per_sqrt_s * np.sqrt(interval_s) * streams("gyro").normal(size=interval_s.size)
    heading_rad = np.interp(times_s, drive.grid_s, drive.true_xyt[:, 2])
    turn_rad = np.diff(heading_rad) * (1.0 + robot.gyro_scale) + robot.gyro_bias_radps * interval_s + noise_rad
    if robot.gyro_walk_radps_per_sqrt_s > 0.0:
        steps = np.sqrt(interval_s) * streams("gyro walk").normal(size=interval_s.size)
        turn_rad = turn_rad + robot.gyro_walk_radps_per_sqrt_s * np.cumsum(steps) * interval_s
    if robot.hard_iron_rad != 0.0:
        compass_rad = heading_rad + drive.start_xyt[2] - robot.hard_iron_from_rad
        turn_rad = turn_rad + robot.hard_iron_rad * np.diff(np.sin(compass_rad))
    return np.asarray(turn_rad)


@dataclass(frozen=True, slots=True)
class Tracker:
    """Rate, noise, dropouts and clock of the ground truth."""

    rate_hz: float = 100.0
    sampling_jitter_s: float = 0.0001
    noise_m: float = 0.002
    noise_rad: float = float(np.radians(0.2))
    dropouts_per_min: float = 1.0
    dropout_mean_s: float = 0.2
    wander_m: float = 0.0
    """Standard deviation of slowly varying errors beside the white noise (satellites, atmosphere, reflections)."""
    wander_tau_s: float = 60.0
    clock_offset_s: float = 0.0
    """Tracker's clock minus true time at the start, s."""
    clock_rate: float = 0.0
    """Tracker's seconds per true second, minus 1."""


TRACKERS: dict[str, Tracker] = {
    "mocap": Tracker(),
    "rtk": Tracker(rate_hz=10.0, noise_m=0.012, noise_rad=float(np.radians(0.4)), dropout_mean_s=0.8, wander_m=0.01),
}


@dataclass(frozen=True, slots=True)
class Track:
    """Tracker output: stamps (s, tracker's clock) and poses (m, 3) of the tracked frame in the world."""

    stamps_s: np.ndarray
    xyt: np.ndarray


def dock(rng: np.random.Generator) -> np.ndarray:
    """Return a random start pose (3,) in the truth frame; m, m, rad."""
    return np.array([*rng.uniform(-8.0, 8.0, size=2), rng.uniform(-np.pi, np.pi)])


def watch(drive: Drive, robot: Robot, tracker: Tracker, streams: Streams) -> Track:
    """Return stamps, s, and poses of the robot's marker in the truth frame, m and rad, as the tracker measures them."""
    grid_s = drive.grid_s
    origin, heading_rad = complex(drive.start_xyt[0], drive.start_xyt[1]), drive.start_xyt[2]

    clock = streams("tracker_clock")
    times_s = jittered_times(grid_s[-1], tracker.rate_hz, tracker.sampling_jitter_s, clock)
    marker_xyt = attach(sample(grid_s, drive.true_xyt, times_s), robot.marker_xyt)
    place = origin + (marker_xyt[:, 0] + 1j * marker_xyt[:, 1]) * np.exp(1j * heading_rad)
    seen_xyt = np.column_stack((place.real, place.imag, marker_xyt[:, 2] + heading_rad))
    noise = streams("tracker").normal(size=seen_xyt.shape)
    seen_xyt += noise * (tracker.noise_m, tracker.noise_m, tracker.noise_rad)
    for axis, name in enumerate(("east", "north") if tracker.wander_m > 0.0 else ()):
        slow = streams(f"tracker wander {name}")
        seen_xyt[:, axis] += gauss_markov_noise(
            tracker.wander_m, tracker.wander_tau_s, 1.0 / tracker.rate_hz, len(seen_xyt), slow
        )

    seen = ~_hidden(times_s, grid_s[-1], tracker, streams("dropouts"))
    stamps_s = times_s * (1.0 + tracker.clock_rate) + tracker.clock_offset_s
    return Track(stamps_s[seen], seen_xyt[seen])


def _hidden(times_s: np.ndarray, duration_s: float, tracker: Tracker, rng: np.random.Generator) -> np.ndarray:
    hidden = np.zeros(times_s.size, dtype=bool)
    for _ in range(rng.poisson(tracker.dropouts_per_min * duration_s / 60.0)):
        begin_s = rng.uniform(0.0, duration_s)
        end_s = begin_s + min(rng.exponential(tracker.dropout_mean_s), 5.0 * tracker.dropout_mean_s)
        hidden |= (times_s >= begin_s) & (times_s < end_s)
    return hidden

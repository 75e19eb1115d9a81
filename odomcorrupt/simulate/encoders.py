"""What the robot itself reports: ticks, perhaps a gyro, and the driver's dead reckoning with nominal numbers."""

from dataclasses import dataclass

import numpy as np

from odomcorrupt.simulate.contact import Drive
from odomcorrupt.simulate.planar import add_up_steps, sample
from odomcorrupt.simulate.robot import Robot


@dataclass(frozen=True, slots=True)
class Rig:
    """The robot's electronics and its floor, whichever flaw it has."""

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
    """The driver's output: true sampling times (s), stamps (s, odometry clock), poses (n, 3) and body twists (n, 3)."""

    stamps_s: np.ndarray
    xyt: np.ndarray
    twist: np.ndarray


def jittered_times(duration_s: float, rate_hz: float, jitter_s: float, rng: np.random.Generator) -> np.ndarray:
    """Return increasing sampling times in [0, duration], with a random phase; s."""
    period_s = 1.0 / rate_hz
    times_s = np.arange(rng.uniform(0.1, 0.9) * period_s, duration_s - period_s, period_s)
    return times_s + np.clip(jitter_s * rng.normal(size=times_s.size), -0.1 * period_s, 0.1 * period_s)


def count(angle_rad: np.ndarray, ticks_per_turn: int | None, rng: np.random.Generator) -> np.ndarray:
    """Return the wheel angle an encoder knows of: the last edge passed; rad."""
    phase = rng.uniform(size=2)
    if ticks_per_turn is None:
        return angle_rad
    ticks = np.floor(angle_rad * (ticks_per_turn / (2 * np.pi)) + phase).astype(np.int64)
    return ticks * (2 * np.pi / ticks_per_turn)


def reckon(
    drive: Drive,
    robot: Robot,
    rig: Rig,
    yaw_from: str,
    rngs: dict[str, np.random.Generator],
) -> Odometry:
    """Run the driver over a drive.

    Parameters
    ----------
    drive : Drive
        What truly happened; the wheels show their angle, and only the gyro feels the body, and only its heading.
    yaw_from : {"encoders", "gyro"}
        Where the driver takes the turn of each interval from.
    rngs : dict of Generator
        Streams ``"odom_clock"``, ``"encoders"`` and ``"gyro"``.
    """
    times_s = jittered_times(drive.grid_s[-1], rig.odom_hz, rig.sampling_jitter_s, rngs["odom_clock"])
    stamp_noise_s = np.clip(rig.stamp_jitter_s * rngs["odom_clock"].normal(size=times_s.size), -0.001, 0.001)
    known_rad = count(sample(drive.grid_s, drive.angle_rad, times_s), rig.ticks_per_turn, rngs["encoders"])
    rim_m = np.diff(known_rad, axis=0) * robot.nominal_radius_m
    forward_m = 0.5 * rim_m.sum(axis=1)
    interval_s = np.diff(times_s)
    gyro_noise_rad = rig.gyro_noise_rad_per_sqrt_s * np.sqrt(interval_s) * rngs["gyro"].normal(size=interval_s.size)
    if yaw_from == "gyro":
        felt_rad = np.diff(np.interp(times_s, drive.grid_s, drive.true_xyt[:, 2]))
        turn_rad = felt_rad + robot.gyro_bias_radps * interval_s + gyro_noise_rad
    else:
        turn_rad = (rim_m[:, 0] - rim_m[:, 1]) / robot.nominal_track_m
    xyt = add_up_steps(forward_m, np.zeros_like(forward_m), turn_rad)
    rate = np.column_stack((forward_m, np.zeros_like(forward_m), turn_rad)) / interval_s[:, None]
    stamps_s = times_s * (1.0 + robot.odom_clock_rate) + robot.odom_clock_offset_s + stamp_noise_s
    return Odometry(stamps_s, xyt, np.vstack((np.zeros(3), rate)))

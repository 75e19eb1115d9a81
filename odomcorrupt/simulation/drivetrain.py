"""Drivetrain: wheel angles from commanded speeds, through motor controller, motors and gear."""

import numpy as np
from scipy.signal import lfilter

from odomcorrupt.simulation.robot import Robot

HUNTING_MPS_PER_RIPPLE = 0.4
HUNTING_TAU_S = 0.25
COGS_PER_TURN = 7


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

    stay = np.exp(-step_s / HUNTING_TAU_S)
    hunting = lfilter([np.sqrt(1.0 - stay**2)], [1.0, -stay], rng.normal(size=rim_mps.shape), axis=0)
    hunting_mps = HUNTING_MPS_PER_RIPPLE * hunting * np.abs(rim_mps) / (np.abs(rim_mps) + 0.05)
    cog_rad = COGS_PER_TURN * np.cumsum(rim_mps, axis=0) * (step_s / robot.nominal_radius_m)
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

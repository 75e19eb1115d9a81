"""The controller and its motors: they follow their commands late and not quite evenly."""

import numpy as np
from scipy.signal import lfilter

from odomcorrupt.simulation.robot import Robot

HUNTING_MPS_PER_RIPPLE = 0.4
HUNTING_TAU_S = 0.25
COGS_PER_TURN = 7


def wheel_angles(
    command: np.ndarray,
    step_s: float,
    robot: Robot,
    ripple: float,
    rng: np.random.Generator,
) -> np.ndarray:
    """Return how far each motor has turned, in turns of its wheel's axle.

    The motor controller, like the driver, knows the nominal machine only: the angles do not depend on its flaws.

    Parameters
    ----------
    command : ndarray, shape (n, 2)
        Forward speed in m/s, turn rate in rad/s.
    step_s : float
        Grid step, s.
    ripple : float
        Relative speed ripple by cogging; the speed controller's hunting goes with it. 0 is a perfect motor.

    Returns
    -------
    ndarray, shape (n, 2)
        Right and left motor angle, rad.
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

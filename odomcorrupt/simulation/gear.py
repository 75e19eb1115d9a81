"""The gear between a motor, whose turn the encoder counts, and its wheel."""

import numpy as np

from odomcorrupt.simulation.robot import Robot


def turn_wheels(motor_rad: np.ndarray, robot: Robot) -> np.ndarray:
    """Return how far the wheels turn when the motors turn so far.

    With play, a motor carries its wheel on the flank it pushes; whoever turns back crosses the gap first.
    It begins with the forward flanks touching.

    Parameters
    ----------
    motor_rad : ndarray, shape (n, 2)
        Right and left motor, in turns of the wheel's axle, rad.

    Returns
    -------
    ndarray, shape (n, 2)
        Right and left wheel, rad.
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

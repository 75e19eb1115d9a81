"""Rubber on the floor: how turning wheels move the body.

Along: a wheel of true radius rolls; its contact point creeps at random, with a variance that grows with the way.
Across: the body has inertia, the tyres hold it by a force in proportion to their sideways creep speed. In the
body's frame Newton says ``m (dv_y/dt + v omega) = -c v_y``, with only ``m / c`` left in the answer.
Further slips (by acceleration, speed, place, slope, bursts) belong into `roll` or beside `creep_sideways`; those that
depend on the place can take the poses of a first pass.
"""

from dataclasses import dataclass

import numpy as np
from scipy.signal import lfilter

from odomcorrupt.simulate.planar import add_up_steps
from odomcorrupt.simulate.robot import Robot


@dataclass(frozen=True, slots=True)
class Drive:
    """What truly happened, on a fine grid.

    Attributes
    ----------
    grid_s : ndarray, shape (n,)
        True time, s.
    angle_rad : ndarray, shape (n, 2)
        Turn of the right and left wheel about their own axles, rad.
    true_xyt : ndarray, shape (n, 3)
        Base (midway between the wheels) from where it began; m, m, unwrapped rad.
    """

    grid_s: np.ndarray
    angle_rad: np.ndarray
    true_xyt: np.ndarray


def roll(turned_rad: np.ndarray, robot: Robot, creep: float, rng: np.random.Generator) -> np.ndarray:
    """Return the way each wheel's contact point makes over the floor.

    Parameters
    ----------
    turned_rad : ndarray, shape (n, 2)
        Turn of the right and left wheel per step, rad.
    creep : float
        Multiplies the robot's random travel (0 for none).

    Returns
    -------
    ndarray, shape (n, 2)
        Travel of the right and left wheel per step, m.
    """
    nominal_m = np.abs(turned_rad) * robot.nominal_radius_m
    noise_m = creep * robot.travel_noise_m_per_sqrt_m * np.sqrt(nominal_m) * rng.normal(size=turned_rad.shape)
    return turned_rad * (robot.radius_right_m, robot.radius_left_m) + noise_m


def creep_sideways(v_mps: np.ndarray, omega_radps: np.ndarray, step_s: float, robot: Robot) -> np.ndarray:
    """Integrate the body's sideways speed under the pull of the turn and the hold of the tyres.

    Parameters
    ----------
    v_mps, omega_radps : ndarray, shape (n,)
        Forward speed and turn rate, constant over each step.

    Returns
    -------
    ndarray, shape (n,)
        Way to the left per step, m.
    """
    settle_s = robot.lateral_creep_s
    if settle_s == 0.0:
        return np.zeros_like(v_mps)
    pull_mps2 = -v_mps * omega_radps
    keep = np.exp(-step_s / settle_s)
    speed_end_mps = lfilter([settle_s * (1.0 - keep)], [1.0, -keep], pull_mps2)
    speed_start_mps = np.concatenate(([0.0], speed_end_mps[:-1]))
    # d(speed)/dt = pull - speed / settle, integrated over a step and solved for the way
    return settle_s * (pull_mps2 * step_s - (speed_end_mps - speed_start_mps))


def drive(grid_s: np.ndarray, angle_rad: np.ndarray, robot: Robot, creep: float, rng: np.random.Generator) -> Drive:
    """Let the wheels carry the body, from rest at the origin.

    Parameters
    ----------
    grid_s : ndarray, shape (n,)
        Evenly spaced true time, s.
    angle_rad : ndarray, shape (n, 2)
        Right and left wheel angle, rad.
    """
    step_s = grid_s[1] - grid_s[0]
    travel_m = roll(np.diff(angle_rad, axis=0), robot, creep, rng)
    forward_m = 0.5 * (travel_m[:, 0] + travel_m[:, 1])
    turn_rad = (travel_m[:, 0] - travel_m[:, 1]) / robot.track_m
    left_m = creep_sideways(forward_m / step_s, turn_rad / step_s, step_s, robot)
    return Drive(grid_s, angle_rad, add_up_steps(forward_m, left_m, turn_rad))

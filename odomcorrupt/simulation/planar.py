"""Rigid motion in the plane, from small steps of constant twist."""

import numpy as np


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

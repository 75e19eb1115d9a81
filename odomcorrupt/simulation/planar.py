"""Rigid motion in the plane, from small steps of constant twist."""

import numpy as np


def add_up_steps(forward_m: np.ndarray, left_m: np.ndarray, turn_rad: np.ndarray) -> np.ndarray:
    """Return the poses reached from the origin by steps of constant body twist, each an exact circular arc.

    Parameters
    ----------
    forward_m, left_m : ndarray, shape (n,)
        Arc lengths along the body's x and y axes, m.
    turn_rad : ndarray, shape (n,)
        Heading change of each step, rad.

    Returns
    -------
    ndarray, shape (n + 1, 3)
        x and y in m, unwrapped heading in rad.
    """
    heading = np.concatenate(([0.0], np.cumsum(turn_rad)))
    midway = heading[:-1] + 0.5 * turn_rad
    chord = np.sinc(turn_rad / (2 * np.pi)) * (forward_m + 1j * left_m) * np.exp(1j * midway)
    place = np.concatenate(([0.0], np.cumsum(chord)))
    return np.column_stack((place.real, place.imag, heading))


def attach(pose_xyt: np.ndarray, mounted_xyt: tuple[float, float, float]) -> np.ndarray:
    """Return the poses of a frame fixed to a moving body.

    Parameters
    ----------
    pose_xyt : ndarray, shape (n, 3)
        Poses of the body; m, m, rad.
    mounted_xyt : tuple of float
        The attached frame seen from the body; m, m, rad.
    """
    x, y, yaw = mounted_xyt
    place = pose_xyt[:, 0] + 1j * pose_xyt[:, 1] + (x + 1j * y) * np.exp(1j * pose_xyt[:, 2])
    return np.column_stack((place.real, place.imag, pose_xyt[:, 2] + yaw))


def sample(grid_s: np.ndarray, values: np.ndarray, at_s: np.ndarray) -> np.ndarray:
    """Return the columns of a finely sampled signal interpolated at other times (headings must be unwrapped).

    Parameters
    ----------
    grid_s : ndarray, shape (n,)
        Increasing times, s.
    values : ndarray, shape (n, c)
        The signal, any unit.
    at_s : ndarray, shape (m,)
        Times wanted, s.

    Returns
    -------
    ndarray, shape (m, c)
    """
    return np.column_stack([np.interp(at_s, grid_s, column) for column in values.T])


def wrap(angle_rad: np.ndarray) -> np.ndarray:
    """Return angles wrapped to (-pi, pi], rad."""
    return np.pi - (np.pi - angle_rad) % (2 * np.pi)

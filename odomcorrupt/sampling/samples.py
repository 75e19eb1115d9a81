"""Where a motion may have ended: samples, and their moments drawn and linearised.

Sampling is that of Probabilistic Robotics (Thrun, Burgard & Fox 2005), table 5.6: the robot turns by a noisy rot1,
drives a noisy trans, turns by a noisy rot2. Corruption of a bag draws the same, increment by increment.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import rotate

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.noise_laws import Variances
    from odomcorrupt.sampling.move import Move

__all__ = ["Ellipse", "Moments", "ellipse", "linearised_moments", "move_sampled", "sample_moments"]


@dataclass(frozen=True, slots=True)
class Moments:
    """Mean (3,) and covariance (3, 3) of x, y (metres) and heading (radians)."""

    mean_xyt: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class Ellipse:
    """An ellipse about a mean position: half axes in metres, the longer one first, and where that one points."""

    centre_xy: Array
    major_m: float
    minor_m: float
    angle_rad: float


def move_sampled(move: Move, variances: Variances, count: int, rng: np.random.Generator) -> Array:
    """Return end poses (count, 3) drawn for a motion; headings are not wrapped.

    variances : (1,) each, of the motion, see `move_variances`
    """
    return with_noise(move, rng.standard_normal((count, 4)) * deviations(variances))


def deviations(variances: Variances) -> Array:
    """Return standard deviations (4,) of rot1, trans, across and rot2."""
    v = variances
    out: Array = np.sqrt(np.concatenate((v.rot1, v.trans, v.across, v.rot2)))
    return out


def with_noise(move: Move, noise: Array) -> Array:
    """Return end poses (n, 3) of a motion to which errors (n, 4) of rot1, trans, across and rot2 are added."""
    rot1, trans, across, rot2 = noise.T
    along = move.along_xy
    left = np.array([-along[1], along[0]])
    travelled = move.shift_xy + trans[:, None] * along + across[:, None] * left
    xy = move.start_xyt[:2] + rotate(travelled, move.swing * rot1)
    return np.column_stack((xy, move.start_xyt[2] + move.turn_rad + rot1 + rot2))


def sample_moments(xyt: Array) -> Moments:
    """Return mean and (unbiased) covariance of samples (n, 3) whose headings are not wrapped."""
    return Moments(xyt.mean(axis=0), np.cov(xyt, rowvar=False))


def linearised_moments(move: Move, variances: Variances) -> Moments:
    """Return what a Kalman filter believes: the odometry's end, and its covariance to first order in the noise."""
    along, shift = move.along_xy, move.shift_xy
    jacobian = np.array(
        [
            [-move.swing * shift[1], along[0], -along[1], 0.0],
            [move.swing * shift[0], along[1], along[0], 0.0],
            [1.0, 0.0, 0.0, 1.0],
        ]
    )
    scaled = jacobian * deviations(variances)
    mean = np.array([*move.end_xyt[:2], move.start_xyt[2] + move.turn_rad])
    return Moments(mean, scaled @ scaled.T)


def ellipse(moments: Moments, sigmas: float) -> Ellipse:
    """Return the ellipse of x and y at so many standard deviations."""
    values, vectors = np.linalg.eigh(moments.covariance[:2, :2])
    minor, major = np.sqrt(np.maximum(values, 0.0)) * sigmas
    angle = np.arctan2(vectors[1, 1], vectors[0, 1])
    return Ellipse(moments.mean_xyt[:2], float(major), float(minor), float(angle))

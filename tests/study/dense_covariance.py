"""The residuals' covariance as a dense matrix, for small problems."""

import numpy as np

from odomcorrupt.study.estimate.whitener import (
    FLOOR,
    odometry_piece,
    quasi_differences,
    rho_of,
    truth_pieces,
    unseen_piece,
)


def dense_covariance(intervals, q, truth):
    """Return the residuals' covariance as a dense matrix (3 K, 3 K)."""
    diagonal, below = (part.copy() for part in unseen_piece(intervals))
    for weight, piece in zip(
        (1.0, truth.xy_m**2, truth.yaw_rad**2, truth.random_walk**2),
        (odometry_piece(intervals, q), *truth_pieces(intervals)),
        strict=True,
    ):
        diagonal += weight * piece[0]
        below += weight * piece[1]
    diagonal[:, [0, 1, 2], [0, 1, 2]] += FLOOR
    k = len(intervals)
    full = np.zeros((3 * k, 3 * k))
    for i in range(k):
        full[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = diagonal[i]
    for i in range(k - 1):
        full[3 * i + 3 : 3 * i + 6, 3 * i : 3 * i + 3] = below[i]
        full[3 * i : 3 * i + 3, 3 * i + 3 : 3 * i + 6] = below[i].T
    rho = rho_of(intervals)
    if rho is not None:
        back = np.linalg.inv(quasi_differences(np.eye(3 * k), rho))
        full = back @ full @ back.T
    return full

"""Banded matrices in LAPACK's lower storage: entry (i, j) of a matrix (n, n) is band[i - j, j], shape (b + 1, n)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import lapack

from odomcorrupt.errors import FitError

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from odomcorrupt.geometry.se2 import Array


def band_factor(band: Array) -> Array:
    """Return the banded Cholesky factor L of a positive definite matrix, both (b + 1, n)."""
    factor, info = lapack.dpbtrf(band, lower=1)
    if info != 0:
        raise FitError("the covariance of the residuals is not positive definite")
    return factor


def band_solve(factor: Array, flat: Array, *, transposed: bool = False) -> Array:
    """Return L^-1 z, or L^-T z, for z of shape (n, c) and a lower banded L (b + 1, n)."""
    if not flat.size:  # LAPACK must not be called without columns
        return flat
    solved, info = lapack.dtbtrs(factor, flat, uplo="L", trans="T" if transposed else "N")
    if info != 0:
        raise FitError("the covariance of the residuals is singular")
    return solved


def half_log_det(factor: Array) -> float:
    """Return half the log determinant of a matrix with Cholesky factor (b + 1, n)."""
    return float(np.log(factor[0]).sum())


def sparse_band(matrix: csr_array, width: int | None = None) -> Array:
    """Return the lower band (width + 1, n) of a symmetric sparse matrix (n, n); by default as wide as necessary."""
    entries = matrix.tocoo()
    below = entries.row - entries.col
    band = np.zeros((int(below.max()) + 1 if width is None else width + 1, matrix.shape[0]), order="F")
    band[below[below >= 0], entries.col[below >= 0]] = entries.data[below >= 0]
    return band


def diagonals(matrix: Array, width: int) -> Array:
    """Return the lower band (width + 1, n) of a matrix (n + width, n), whose last rows are zero, as a view."""
    row, column = matrix.strides
    return np.lib.stride_tricks.as_strided(matrix, (width + 1, matrix.shape[1]), (row, row + column), writeable=True)

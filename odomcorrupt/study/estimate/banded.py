"""Banded matrices in LAPACK's lower storage: entry (i, j) of a matrix (n, n) is band[i - j, j], shape (b + 1, n).

Selected inverse: the entries of a banded covariance's inverse inside the band, for gradients of the likelihood.

Takahashi's recursion runs through the Cholesky factor from the last node to the first: with C_k = (L_kk L_kk')^-1 and
G_k = L_k+1,k L_kk^-1, the inverse's own blocks are Z_k = C_k + G_k' Z_k+1 G_k, and those below them -Z_k+1 G_k
(Takahashi, Fagan & Chin 1973; Erisman & Tinney 1975). The six numbers of each symmetric block are linear in those of
the next, so the whole recursion is one banded triangular system.
"""

from __future__ import annotations

from itertools import combinations_with_replacement
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


_PAIRS = tuple(combinations_with_replacement(range(3), 2))
_REACH = 11
"""Bandwidth of the recursion's system: the largest distance between the six numbers of a block and of the next."""


def inverse_band(factor: Array) -> Array:
    """Return the lower band (6, 3 K) of the inverse of a block tridiagonal matrix from its Cholesky factor (6, 3 K)."""
    lower, below = _blocks(factor)
    own = _inverses(lower)
    g = np.einsum("imk,mjk->ijk", below, own)
    c = np.stack([np.einsum("mk,mk->k", own[:, i], own[:, j]) for i, j in _PAIRS], axis=1)
    z = _solved(g, c)
    band, whole = np.zeros_like(factor), np.zeros_like(g)
    for n, (i, j) in enumerate(_PAIRS):
        band[j - i, i::3] = whole[i, j] = whole[j, i] = z[:, n]
    after = np.einsum("imk,mjk->ijk", whole[:, :, 1:], g[:, :, :-1])
    for i, j in np.ndindex(3, 3):
        band[3 + i - j, j:-3:3] = -after[i, j]
    return band


def _blocks(factor: Array) -> tuple[Array, Array]:
    """Return the factor's blocks on the diagonal and below it, (3, 3, K) each."""
    lower, below = np.zeros((2, 3, 3, factor.shape[1] // 3))
    for i, j in np.ndindex(3, 3):
        below[i, j] = factor[3 + i - j, j::3]
        if i >= j:
            lower[i, j] = factor[i - j, j::3]
    return lower, below


def _inverses(lower: Array) -> Array:
    """Return the inverses of lower triangular matrices, both (3, 3, K)."""
    inverse = np.zeros_like(lower)
    for i in range(3):
        inverse[i, i] = 1.0 / lower[i, i]
    inverse[1, 0] = -lower[1, 0] * inverse[0, 0] * inverse[1, 1]
    inverse[2, 1] = -lower[2, 1] * inverse[1, 1] * inverse[2, 2]
    inverse[2, 0] = -(lower[2, 0] * inverse[0, 0] + lower[2, 1] * inverse[1, 0]) * inverse[2, 2]
    return inverse


def _solved(g: Array, own: Array) -> Array:
    """Return z (K, 6), the solution of z_k = own_k + g_k' z_k+1 g_k, as six numbers per symmetric block."""
    count = len(own)
    # (column of the system, diagonal): transposed, it is the upper band that LAPACK expects
    system = np.zeros((count, 6, _REACH + 1))
    for row, (i, j) in enumerate(_PAIRS):
        for column, (a, b) in enumerate(_PAIRS):
            weight = g[a, i, :-1] * g[b, j, :-1]
            if a != b:
                weight = weight + g[b, i, :-1] * g[a, j, :-1]
            system[1:, column, _REACH - 6 + row - column] = -weight
    z, info = lapack.dtbtrs(system.reshape(6 * count, -1).T, own.reshape(-1, 1), uplo="U", diag="U", overwrite_b=1)
    if info != 0:
        raise FitError("the covariance of the residuals is singular")
    return z.reshape(count, 6)

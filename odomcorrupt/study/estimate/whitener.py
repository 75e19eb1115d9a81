"""The likelihood of node-to-node residuals when the truth is noisy, too.

Noise v of the truth at a node spoils the interval before it and the one after it, with opposite signs, so neighbouring
residuals are correlated: e_k = (columns) + w_k - v_{k+1} + A_k v_k with A_k = Ad(D_k^-1). Their joint covariance is
block tridiagonal, and one banded Cholesky factor whitens residual and columns alike, in linear time
(it equals the marginal likelihood of a linearised Kalman filter with a diffuse start).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import lapack

from odomcorrupt.errors import FitError

if TYPE_CHECKING:
    from scipy.sparse import csr_array

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import TruthNoise
    from odomcorrupt.study.estimate.intervals import Intervals

__all__ = [
    "Shrunk",
    "Whitener",
    "band_of",
    "dense_covariance",
    "factored",
    "fixed_band",
    "interval_covariance",
    "truth_pieces",
    "truth_weights",
    "whitener",
]

FLOOR = np.array([1e-10, 1e-10, 1e-12])
"""Variance that nothing falls below (10 um, 1 urad): a robot that stands still must not make a singular matrix."""
BAND = 5


@dataclass(frozen=True, slots=True)
class Shrunk:
    """Orthonormal directions L^-1 S M of whitened residuals along which a process makes them shrink.

    As S is sparse and M small they are never multiplied out: that would take as much memory as hundreds of columns, and
    most of the time of everything that is whitened.

    spread : S (3 K, k) what each knot of a process does to each residual, sparse
    mixing : M (k, m) of the knots, for each direction
    factors : (m,) by which whitened data shrink along them
    """

    spread: csr_array
    mixing: Array
    factors: Array


@dataclass(frozen=True, slots=True)
class Whitener:
    """The banded Cholesky factor L of the residuals' covariance.

    factor : (6, 3 K) lower banded
    log_det : sum of log of L's diagonal
    shrunk : what a process spread over all residuals adds to the covariance; none by default
    """

    factor: Array
    log_det: float
    shrunk: Shrunk | None = None

    def whiten(self, columns: Array) -> Array:
        """Return L^-1 x for x of shape (K, 3) or (K, 3, c), as (3 K,) or (3 K, c): standardised innovations."""
        solved = self.whitened(columns.reshape(self.factor.shape[1], -1))
        return solved[:, 0] if columns.ndim == 2 else solved

    def whitened(self, flat: Array) -> Array:
        """Return L^-1 x for x of shape (3 K, c)."""
        if not flat.shape[1]:  # LAPACK writes where there is nothing
            return flat
        white = self._solved(flat)
        return white if self.shrunk is None else white - self._lost(white, self.shrunk)

    def pulled(self, white: Array) -> Array:
        """Return (K, 3) whose product with any column x is that of L^-1 x with whitened data (3 K,)."""
        rest = white[:, None]
        if self.shrunk is not None:
            rest = rest - self._lost(rest, self.shrunk)
        return self._solved(rest, transposed=True).reshape(-1, 3)

    def _lost(self, white: Array, shrunk: Shrunk) -> Array:
        """Return what data (3 K, c) that are whitened by the band alone lose along the directions of a process."""
        along = shrunk.mixing.T @ (shrunk.spread.T @ self._solved(white, transposed=True))
        return self._solved(shrunk.spread @ (shrunk.mixing @ ((1.0 - shrunk.factors)[:, None] * along)))

    def _solved(self, flat: Array, *, transposed: bool = False) -> Array:
        """Return L^-1 x for x of shape (3 K, c), or its transpose's."""
        solved, info = lapack.dtbtrs(self.factor, flat, uplo="L", trans="T" if transposed else "N")
        if info != 0:
            raise FitError("the covariance of the residuals is singular")
        back: Array = solved
        return back

    def log_likelihood(self, innovations: Array) -> float:
        """Return the log density in nats of whitened residuals (3 K,)."""
        n = len(innovations)
        return float(-self.log_det - 0.5 * innovations @ innovations - 0.5 * n * np.log(2.0 * np.pi))


def interval_covariance(nodes: Intervals, q: Array, truth: TruthNoise) -> Array:
    """Return the covariance (K, 3, 3) of each residual by itself: odometry's noise q, and the truth's at both ends."""
    total = q + unseen_piece(nodes)[0]
    for weight, (diagonal, _) in zip(truth_weights(truth), truth_pieces(nodes), strict=True):
        total += weight * diagonal
    total[:, [0, 1, 2], [0, 1, 2]] += FLOOR
    return total


def truth_weights(truth: TruthNoise) -> tuple[float, float, float]:
    """Return the weights of `truth_pieces`."""
    return truth.xy_m**2, truth.yaw_rad**2, truth.random_walk**2


def truth_pieces(nodes: Intervals) -> list[tuple[Array, Array]]:
    """Return what unit noise of the truth adds, for its position, its heading and its random walk.

    Each is a pair: added to the residuals' own covariances (K, 3, 3), and to those with the one before (K - 1, 3, 3).
    """
    a = _adjoint_of_inverse(nodes.truth_step)
    pieces = [
        _at_ends(nodes, a, kept @ nodes.start_shape @ kept, kept @ nodes.end_shape @ kept)
        for kept in (np.diag([1.0, 1.0, 0.0]), np.diag([0.0, 0.0, 1.0]))
    ]
    random_walk = np.zeros_like(a)
    random_walk[:, [0, 1], [0, 1]] = (nodes.random_walk_level**2 * (nodes.end_s - nodes.start_s))[:, None]
    pieces.append((random_walk, np.zeros_like(a[1:])))
    return pieces


def unseen_piece(nodes: Intervals) -> tuple[Array, Array]:
    """Return what is added where the truth knows nothing along an axis, as a pair like those of `truth_pieces`."""
    return _at_ends(nodes, _adjoint_of_inverse(nodes.truth_step), nodes.start_unseen, nodes.end_unseen)


def _at_ends(nodes: Intervals, a: Array, start: Array, end: Array) -> tuple[Array, Array]:
    """Return what covariances (K, 3, 3) of the truth at both ends of intervals add to their residuals."""
    ar = a @ start
    return end + ar @ np.swapaxes(a, 1, 2), -ar[1:] * nodes.linked[1:, None, None]


def band_of(diagonal: Array, below: Array | None = None) -> Array:
    """Return blocks (K, 3, 3) on the diagonal, and (K - 1, 3, 3) below it, as a lower banded matrix (6, 3 K)."""
    k = len(diagonal)
    band = np.zeros((BAND + 1, 3 * k))
    for row in range(3):
        for column in range(row + 1):
            band[row - column, column::3] = diagonal[:, row, column]
        for column in range(3):
            if below is not None:
                band[3 + row - column, column : 3 * (k - 1) : 3] = below[:, row, column]
    return band


def whitener(nodes: Intervals, q: Array, truth: TruthNoise) -> Whitener:
    """Factor the covariance of the residuals.

    Parameters
    ----------
    nodes : K intervals
    q : (K, 3, 3)
        Covariance that the odometry's noise law puts on each residual, m and rad.
    truth : how noisy the truth is

    """
    band = band_of(q) + fixed_band(nodes)
    for weight, piece in zip(truth_weights(truth), truth_pieces(nodes), strict=True):
        band += weight * band_of(*piece)
    return factored(band)


def fixed_band(nodes: Intervals) -> Array:
    """Return what is no parameter's of the covariance, as a band (6, 3 K): its floor, and axes that are not seen."""
    band = band_of(*unseen_piece(nodes))
    band[0] += np.tile(FLOOR, len(nodes))
    return band


def factored(band: Array) -> Whitener:
    """Return the whitener of a lower banded covariance (6, 3 K)."""
    factor, info = lapack.dpbtrf(band, lower=1)
    if info != 0:
        raise FitError("the covariance of the residuals is not positive definite")
    return Whitener(factor, float(np.sum(np.log(factor[0]))))


def dense_covariance(nodes: Intervals, q: Array, truth: TruthNoise) -> Array:
    """Return the same covariance as a plain matrix (3 K, 3 K), for small K: tests and the curious."""
    diagonal = interval_covariance(nodes, q, truth)
    below = unseen_piece(nodes)[1].copy()
    for weight, piece in zip(truth_weights(truth), truth_pieces(nodes), strict=True):
        below += weight * piece[1]
    k = len(nodes)
    full = np.zeros((3 * k, 3 * k))
    for i in range(k):
        full[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = diagonal[i]
    for i in range(k - 1):
        full[3 * i + 3 : 3 * i + 6, 3 * i : 3 * i + 3] = below[i]
        full[3 * i : 3 * i + 3, 3 * i + 3 : 3 * i + 6] = below[i].T
    return full


def _adjoint_of_inverse(xyt: Array) -> Array:
    """Return Ad(D^-1) (K, 3, 3) of poses D (K, 3)."""
    c, s = np.cos(xyt[:, 2]), np.sin(xyt[:, 2])
    x, y = xyt[:, 0], xyt[:, 1]
    a = np.zeros((len(xyt), 3, 3))
    a[:, 0, 0], a[:, 0, 1], a[:, 1, 0], a[:, 1, 1], a[:, 2, 2] = c, s, -s, c, 1.0
    # J R^T d: where the rotation by a heading error moves the far end
    a[:, 0, 2] = -(-s * x + c * y)
    a[:, 1, 2] = c * x + s * y
    return a

"""Covariance and whitening of residuals between nodes, including the noise of the truth.

Noise v of the truth at a node affects the interval before it and the one after it, with opposite signs, so neighbouring
residuals are correlated: e_k = (columns) + w_k - v_{k+1} + A_k v_k with A_k = Ad(D_k^-1). Their joint covariance is
block tridiagonal, and one banded Cholesky factor whitens residual and columns alike, in linear time
(the likelihood equals the marginal one of a linearised Kalman filter with a diffuse start).

Errors of a localisation are correlated along the path: a mean-reverting process c on the map (Ornstein-Uhlenbeck over
path length), c_{k+1} = m_k c_k + n_k, which correlates all residuals. Quasi-differences z_k = e_k - rho_k e_{k-1}, with
rho_k = m_{k-1} B_k B_{k-1}^-1 and B_k = A_k N_k - m_k N_{k+1}, contain only the new errors n (N_k rotates axes of the
map into those of a node). Their covariance is block tridiagonal again. They have the same likelihood as the residuals,
because the transformation between the two has determinant 1.

The values of a Markov process at its knots have a banded precision, and so has their posterior, because a knot acts
only between its neighbours (Rue & Held 2005, Gaussian Markov Random Fields, sections 2.4 and 3.1). The covariance that
the process adds to the residuals is never formed.

Banded matrices are in LAPACK's lower storage: entry (i, j) of a matrix (n, n) is band[i - j, j], shape (b + 1, n).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np
from scipy.linalg import lapack
from scipy.sparse import csc_array, hstack

from odomcorrupt.errors import FitError
from odomcorrupt.geometry.se2 import rotate

if TYPE_CHECKING:
    from scipy.sparse import csr_array, sparray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import TruthNoise
    from odomcorrupt.study.estimate.intervals import Intervals


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


def sparse_band(matrix: sparray, width: int | None = None) -> Array:
    """Return the lower band (width + 1, n) of a symmetric sparse matrix (n, n); by default as wide as necessary."""
    entries = matrix.tocoo()
    below = entries.row - entries.col
    band = np.zeros((int(below.max()) + 1 if width is None else width + 1, matrix.shape[0]), order="F")
    band[below[below >= 0], entries.col[below >= 0]] = entries.data[below >= 0]
    return band


@dataclass(frozen=True, slots=True)
class KnotPosterior:
    """Posterior of a process's values at its knots, and the whitening correction for the process.

    With W = L^-1 S, the prior's precision Q = D D' and the posterior's Q + W' W = C C', residuals whitened by L are
    whitened for the process, too, by T = I - W (C + D)^-T C^-1 W', because T' T = I - W (Q + W' W)^-1 W' (a square root
    as in Andrews 1968, AIAA Journal 6(6), with banded factors).

    knots : W (3 K, k), sparse
    factor, prior : C and D, lower banded (b + 1, k)
    """

    knots: csc_array
    factor: Array
    prior: Array

    @classmethod
    def of(cls, knots: csc_array, precision: csr_array) -> Self:
        """Return the posterior for the precision (k, k) of the prior."""
        information = sparse_band(knots.T @ knots + precision)
        prior = sparse_band(precision, len(information) - 1)
        return cls(knots, band_factor(information), band_factor(prior))

    @property
    def log_growth(self) -> float:
        """Half the logarithm of the factor by which the process increases the determinant of the covariance."""
        return half_log_det(self.factor) - half_log_det(self.prior)

    def scores(self, white: Array) -> Array:
        """Return C^-1 W' z (k, c) of band-whitened data z (3 K, c)."""
        return band_solve(self.factor, self.knots.T @ white)

    def values(self, scores: Array) -> Array:
        """Return values C^-T y (k, c) at the knots: of `scores` the posterior mean, of normals its deviations."""
        return band_solve(self.factor, scores, transposed=True)

    def lost(self, white: Array, *, transposed: bool = False) -> Array:
        """Return z - T z, or z - T' z, of band-whitened data z (3 K, c)."""
        both = self.factor + self.prior
        if transposed:
            values = self.values(band_solve(both, self.knots.T @ white))
        else:
            values = band_solve(both, self.scores(white), transposed=True)
        return self.knots @ values


FLOOR = np.array([1e-10, 1e-10, 1e-12])
"""Lower limit of the variances (10 um, 1 urad), so that the matrix is not singular while the robot stands still."""
BAND = 5
_KEPT = (np.diag([1.0, 1.0, 0.0]), np.diag([0.0, 0.0, 1.0]))
_TINY = 1e-18 * np.eye(3)
_KNOTS, _FADED = 32, 1e-11
"""Number of knots that are whitened together; fraction of its largest value below which a knot's contribution to later
innovations is dropped."""


@dataclass(frozen=True, slots=True)
class Whitener:
    """The banded Cholesky factor L of the residuals' covariance.

    factor : (6, 3 K) lower banded
    log_det : sum of log of L's diagonal
    process : random processes in the covariance; None by default
    rho : (K, 3, 3) of the quasi-differences to which L belongs, see above; None if it belongs to the residuals
    """

    factor: Array
    log_det: float
    process: KnotPosterior | None = None
    rho: Array | None = None

    def whiten(self, columns: Array) -> Array:
        """Return L^-1 x for x of shape (K, 3) or (K, 3, c), as (3 K,) or (3 K, c): standardised innovations."""
        solved = self.whitened(columns.reshape(self.factor.shape[1], -1))
        return solved[:, 0] if columns.ndim == 2 else solved

    def whitened(self, flat: Array) -> Array:
        """Return L^-1 x like `whiten`, for x of shape (3 K, c)."""
        white = self._by_band(flat)
        return white if self.process is None else white - self.process.lost(white)

    def knots(self, spread: csr_array) -> csc_array:
        """Return L^-1 S (3 K, k) of the knots of a process (3 K, k), whitened by the band alone.

        A knot acts only between its neighbours, and L^-1 decays after it: what is negligible is left out.
        """
        by_knot, parts = spread.tocsc(), []
        for knot in range(0, spread.shape[1], _KNOTS):
            values = self._by_band(by_knot[:, knot : knot + _KNOTS].toarray(order="F"))
            size = np.abs(values)
            parts.append(csc_array(np.where(size > _FADED * size.max(axis=0), values, 0.0)))
        return csc_array(hstack(parts, format="csc"))

    def information(self, spread: csr_array) -> Array:
        """Return W' W (k, k) of the whitened columns W of a sparse S (3 K, k)."""
        knots = self.knots(spread)
        information: Array = (knots.T @ knots).toarray()
        if self.process is not None:
            along = band_solve(self.process.factor, (self.process.knots.T @ knots).toarray(order="F"))
            information -= along.T @ along
        return information

    def pulled(self, white: Array) -> Array:
        """Return L^-T z (K, 3) of whitened data z (3 K,); its product with a column x equals that of z with L^-1 x."""
        return self.transposed(white[:, None]).reshape(-1, 3)

    def transposed(self, white: Array) -> Array:
        """Return L^-T z (3 K, c) of whitened data z (3 K, c), the transpose of `whitened`."""
        if self.process is not None:
            white = white - self.process.lost(white, transposed=True)
        back = band_solve(self.factor, white, transposed=True)
        if self.rho is None:
            return back
        blocks = back.reshape(len(self.rho), 3, -1)
        carried = np.einsum("kji,kjc->kic", self.rho[1:], blocks[1:])
        return np.concatenate((blocks[:-1] - carried, blocks[-1:])).reshape(white.shape)

    def _by_band(self, flat: Array) -> Array:
        """Return x of shape (3 K, c) whitened by the band alone."""
        return band_solve(self.factor, flat if self.rho is None else quasi_differences(flat, self.rho))

    def log_likelihood(self, innovations: Array) -> float:
        """Return the log density, nats, of residuals whose whitened values (3 K,) are given."""
        n = len(innovations)
        return float(-self.log_det - 0.5 * innovations @ innovations - 0.5 * n * np.log(2.0 * np.pi))


def interval_covariance(intervals: Intervals, q: Array, truth: TruthNoise) -> Array:
    """Return the marginal covariance (K, 3, 3) of residuals: noise q of the odometry plus the truth's at both ends."""
    alone = replace(intervals, linked=np.zeros_like(intervals.linked))
    total = q + unseen_piece(alone)[0]
    for weight, (diagonal, _) in zip(truth_weights(truth), truth_pieces(alone), strict=True):
        total += weight * diagonal
    total[:, [0, 1, 2], [0, 1, 2]] += FLOOR
    return total


def truth_weights(truth: TruthNoise) -> tuple[float, float, float]:
    """Return the weights of `truth_pieces`."""
    return truth.xy_m**2, truth.yaw_rad**2, truth.random_walk**2


def truth_pieces(intervals: Intervals) -> list[tuple[Array, Array]]:
    """Return covariance contributions of unit truth noise: of position, of heading and of the random walk.

    Each is a pair: the contribution to the covariance (K, 3, 3) of each residual (or quasi-difference, if errors of the
    truth are correlated) and to that with the previous one (K - 1, 3, 3).
    """
    start, end, b = map_axes(intervals)
    rho, linked = rho_of(intervals), intervals.linked
    # the new error at the interval's end, and that of the previous end; the first of a chain has the full variance
    before = b if rho is None else b + rho @ start
    fresh = 1.0 - intervals.memory**2
    earlier = np.where(linked, np.concatenate(([1.0], fresh[:-1])), 1.0)
    pieces = []
    for kept in _KEPT:
        at_end, at_start = (m @ kept @ np.swapaxes(m, 1, 2) for m in (end, before))
        diagonal = at_end * fresh[:, None, None] + at_start * earlier[:, None, None]
        below = before[1:] @ kept @ np.swapaxes(end[:-1], 1, 2)
        pieces.append((diagonal, -below * (earlier * linked)[1:, None, None]))
    walk = np.zeros((len(intervals), 3, 3))
    walk[:, [0, 1], [0, 1]] = (intervals.random_walk_level**2 * (intervals.end_s - intervals.start_s))[:, None]
    return [*pieces, odometry_piece(intervals, walk)]


def odometry_piece(intervals: Intervals, q: Array) -> tuple[Array, Array]:
    """Return the contribution of independent noise q (K, 3, 3) of each residual, as a pair like `truth_pieces`."""
    below = np.zeros_like(q[1:])
    if (rho := rho_of(intervals)) is None:
        return q, below
    turned = rho[1:] @ q[:-1]
    diagonal = q.copy()
    diagonal[1:] += turned @ np.swapaxes(rho[1:], 1, 2)
    return diagonal, -turned


def rho_of(intervals: Intervals) -> Array | None:
    """Return rho (K, 3, 3), the factor on the previous residual in a quasi-difference; None if there is none."""
    if not intervals.memory.any():
        return None
    _, _, b = map_axes(intervals)
    rho = np.zeros_like(b)
    linked = np.flatnonzero(intervals.linked[1:] & (intervals.memory[:-1] > 0.0)) + 1
    rho[linked] = intervals.memory[linked - 1, None, None] * (b[linked] @ np.linalg.inv(b[linked - 1]))
    return rho


def map_axes(intervals: Intervals) -> tuple[Array, Array, Array]:
    """Return N at the start and the end of each interval, and B, all (K, 3, 3), see above."""
    start_rad = intervals.truth_xyt[:, 2]
    start = np.linalg.cholesky(intervals.start_shape + _TINY) @ _turned(-start_rad)
    end = np.linalg.cholesky(intervals.end_shape + _TINY) @ _turned(-start_rad - intervals.truth_step[:, 2])
    b = _adjoint_of_inverse(intervals.truth_step) @ start - intervals.memory[:, None, None] * end
    return start, end, b


def _turned(angle_rad: Array) -> Array:
    turned = np.zeros((len(angle_rad), 3, 3))
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    turned[:, 0, 0], turned[:, 0, 1], turned[:, 1, 0], turned[:, 1, 1], turned[:, 2, 2] = c, -s, s, c, 1.0
    return turned


def quasi_differences(flat: Array, rho: Array) -> Array:
    """Return z_k = x_k - rho_k x_{k-1} of columns (3 K, c), each contiguous in memory."""
    x = flat.reshape(len(rho), 3, -1)
    z = x.copy()
    z[1:] -= rho[1:] @ x[:-1]
    return np.asfortranarray(z.reshape(flat.shape))


def unseen_piece(intervals: Intervals) -> tuple[Array, Array]:
    """Return the contribution of axes that the truth does not measure, as a pair like `truth_pieces`."""
    a = _adjoint_of_inverse(intervals.truth_step)
    at_start = a @ intervals.start_unseen
    below = -at_start[1:] * intervals.linked[1:, None, None]
    return intervals.end_unseen + at_start @ np.swapaxes(a, 1, 2), below


def band_of(diagonal: Array, below: Array) -> Array:
    """Return blocks (K, 3, 3) on the diagonal, and (K - 1, 3, 3) below it, as a lower banded matrix (6, 3 K)."""
    k = len(diagonal)
    band = np.zeros((BAND + 1, 3 * k))
    for row in range(3):
        for column in range(row + 1):
            band[row - column, column::3] = diagonal[:, row, column]
        for column in range(3):
            band[3 + row - column, column : 3 * (k - 1) : 3] = below[:, row, column]
    return band


def whitener(intervals: Intervals, q: Array, truth: TruthNoise) -> Whitener:
    """Return the whitener of the residuals from the noise of odometry and truth.

    q : (K, 3, 3) covariance that the odometry's noise law puts on each residual, m and rad
    """
    band = band_of(*odometry_piece(intervals, q)) + fixed_band(intervals)
    for weight, piece in zip(truth_weights(truth), truth_pieces(intervals), strict=True):
        band += weight * band_of(*piece)
    return factored(band, rho_of(intervals))


def fixed_band(intervals: Intervals) -> Array:
    """Return the constant part of the covariance as a band (6, 3 K): its floor, and axes not measured by the truth."""
    band = band_of(*unseen_piece(intervals))
    band[0] += np.tile(FLOOR, len(intervals))
    return band


def factored(band: Array, rho: Array | None) -> Whitener:
    """Return the whitener of a lower banded covariance (6, 3 K) of residuals, or of their quasi-differences."""
    factor = band_factor(band)
    return Whitener(factor, half_log_det(factor), rho=rho)


def _adjoint_of_inverse(xyt: Array) -> Array:
    """Return Ad(D^-1) (K, 3, 3) of poses D (K, 3)."""
    a = _turned(-xyt[:, 2])
    # J R^T d: displacement of the far end by a heading error
    ahead, left = rotate(xyt[:, :2], -xyt[:, 2]).T
    a[:, 0, 2], a[:, 1, 2] = -left, ahead
    return a

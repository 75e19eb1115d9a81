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

Knots of a random process: their whitened columns, and their posterior given whitened residuals.

The values of a Markov process at its knots have a banded precision, and so has their posterior, because a knot acts
only between its neighbours (Rue & Held 2005, Gaussian Markov Random Fields, sections 2.4 and 3.1). The covariance that
the process adds to the residuals is never formed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from odomcorrupt.study.estimate.banded import band_factor, band_solve, diagonals, half_log_det, sparse_band

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scipy.sparse import csr_array

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import TruthNoise
    from odomcorrupt.study.estimate.intervals import Intervals


@dataclass(frozen=True, slots=True)
class WhitenedKnots:
    """L^-1 S of a sparse S (3 K, k), stored as blocks of columns over the rows in which they are not negligible.

    A knot acts only between its neighbours, and L^-1 decays after it. Dense columns would slow down every product.

    blocks : first row, first knot, and values (rows, knots) of each block, in order of knots
    count : number of knots k
    """

    blocks: tuple[tuple[int, int, Array], ...]
    count: int

    def inner(self, other: WhitenedKnots) -> Array:
        """Return S' V^-1 T (k, l) with other knots T, whitened by the same factor."""
        inner = np.zeros((self.count, other.count))
        for knot, there, own, values in self._overlaps(other):
            inner[knot : knot + own.shape[1], there : there + values.shape[1]] = own.T @ values
        return inner

    def _overlaps(self, other: WhitenedKnots) -> Iterator[tuple[int, int, Array, Array]]:
        """Yield the first knots of two blocks that share rows, and the values of each on these rows."""
        for row, knot, own in self.blocks:
            for later, there, values in other.blocks:
                begin, end = max(row, later), min(row + len(own), later + len(values))
                if begin < end:
                    yield knot, there, own[begin - row : end - row], values[begin - later : end - later]

    def information(self, precision: csr_array) -> Array:
        """Return S' V^-1 S + Q (b + 1, k), as a lower band, for the precision Q (k, k) of the knots' prior."""
        below = ((knot, there, own, values) for knot, there, own, values in self._overlaps(self) if there >= knot)
        products = [(there, knot, values.T @ own) for knot, there, own, values in below]
        prior = precision.tocoo()
        width = max((there + block.shape[0] - 1 - knot for there, knot, block in products), default=0)
        width = min(max(width, int((prior.row - prior.col).max())), self.count - 1)
        whole = np.zeros((self.count + width, self.count))
        for there, knot, block in products:
            whole[there : there + block.shape[0], knot : knot + block.shape[1]] = block
        whole[prior.row, prior.col] += prior.data
        return np.asfortranarray(diagonals(whole, width))

    def products(self, white: Array) -> Array:
        """Return S' L^-T z (k, c) of whitened data (3 K, c)."""
        products = np.zeros((self.count, white.shape[1]))
        for row, knot, values in self.blocks:
            products[knot : knot + values.shape[1]] = values.T @ white[row : row + len(values)]
        return products

    def columns(self, values: Array, rows: int) -> Array:
        """Return L^-1 S x (3 K, c) of values x (k, c) at the knots; rows is 3 K."""
        columns = np.zeros((rows, values.shape[1]), order="F")
        for row, knot, own in self.blocks:
            columns[row : row + len(own)] += own @ values[knot : knot + own.shape[1]]
        return columns


@dataclass(frozen=True, slots=True)
class KnotPosterior:
    """Posterior of a process's values at its knots, and the whitening correction for the process.

    With W = L^-1 S, the prior's precision Q = D D' and the posterior's Q + W' W = C C', residuals whitened by L are
    whitened for the process, too, by T = I - W (C + D)^-T C^-1 W', because T' T = I - W (Q + W' W)^-1 W' (a square root
    as in Andrews 1968, AIAA Journal 6(6), with banded factors).

    knots : W
    factor, prior : C and D, lower banded (b + 1, k)
    """

    knots: WhitenedKnots
    factor: Array
    prior: Array

    @classmethod
    def of(cls, knots: WhitenedKnots, precision: csr_array) -> Self:
        """Return the posterior for the precision (k, k) of the prior."""
        information = knots.information(precision)
        prior = sparse_band(precision, len(information) - 1)
        return cls(knots, band_factor(information), band_factor(prior))

    @property
    def log_growth(self) -> float:
        """Half the logarithm of the factor by which the process increases the determinant of the covariance."""
        return half_log_det(self.factor) - half_log_det(self.prior)

    def scores(self, white: Array) -> Array:
        """Return C^-1 W' z (k, c) of band-whitened data z (3 K, c)."""
        return band_solve(self.factor, self.knots.products(white))

    def values(self, scores: Array) -> Array:
        """Return values C^-T y (k, c) at the knots: of `scores` the posterior mean, of normals its deviations."""
        return band_solve(self.factor, scores, transposed=True)

    def lost(self, white: Array, *, transposed: bool = False) -> Array:
        """Return z - T z, or z - T' z, of band-whitened data z (3 K, c)."""
        both = self.factor + self.prior
        if transposed:
            values = self.values(band_solve(both, self.knots.products(white)))
        else:
            values = band_solve(both, self.scores(white), transposed=True)
        return self.knots.columns(values, len(white))


FLOOR = np.array([1e-10, 1e-10, 1e-12])
"""Lower limit of the variances (10 um, 1 urad), so that the matrix is not singular while the robot stands still."""
BAND = 5
_KEPT = (np.diag([1.0, 1.0, 0.0]), np.diag([0.0, 0.0, 1.0]))
_TINY = 1e-18 * np.eye(3)


_KNOTS, _ROWS = 32, 96
"""Number of knots that are whitened together, and of rows after them in the first attempt."""
_FADED = 1e-11
"""Fraction of its largest value below which a knot's contribution to later innovations is dropped."""


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

    def solved(self, flat: Array) -> Array:
        """Return L^-1 z for quasi-differences z of shape (3 K, c)."""
        return band_solve(self.factor, flat)

    def whitened(self, flat: Array) -> Array:
        """Return L^-1 x like `whiten`, for x of shape (3 K, c)."""
        white = self._by_band(flat)
        return white if self.process is None else white - self.process.lost(white)

    def knots(self, spread: csr_array) -> WhitenedKnots:
        """Return L^-1 S of the knots of a process (3 K, k), whitened by the band alone."""
        by_knot, rows = spread.tocsc(), spread.shape[0]
        blocks = []
        for knot in range(0, spread.shape[1], _KNOTS):
            own = by_knot[:, knot : knot + _KNOTS]
            if not own.nnz:
                continue
            first, last = 3 * (int(own.indices.min()) // 3), int(own.indices.max()) + 1
            length = _ROWS
            while True:
                end = min(3 * (-(-last // 3)) + length, rows)
                part = replace(
                    self,
                    factor=self.factor[:, first:end],
                    rho=None if self.rho is None else self.rho[first // 3 : end // 3],
                )
                values = part._by_band(own[first:end].toarray(order="F"))  # noqa: SLF001 - of the same class
                if end == rows or np.abs(values[-2 * BAND :]).max() <= _FADED * np.abs(values).max():
                    break
                length *= 3
            size = np.abs(values).max(axis=1)
            there = np.flatnonzero(size > _FADED * size.max(initial=0.0))
            if len(there):
                blocks.append((first, knot, np.asfortranarray(values[: there[-1] + 1])))
        return WhitenedKnots(tuple(blocks), spread.shape[1])

    def information(self, spread: csr_array) -> Array:
        """Return W' W (k, k) of the whitened columns W of a sparse S (3 K, k)."""
        knots = self.knots(spread)
        information = knots.inner(knots)
        if self.process is not None:
            along = band_solve(self.process.factor, self.process.knots.inner(knots))
            information -= along.T @ along
        return information

    def pulled(self, white: Array) -> Array:
        """Return L^-T z (K, 3) of whitened data z (3 K,); its product with a column x equals that of z with L^-1 x."""
        return self.transposed(white[:, None]).reshape(-1, 3)

    def transposed(self, white: Array) -> Array:
        """Return L^-T z (3 K, c) of whitened data z (3 K, c), the transpose of `whitened`."""
        return self._back(white if self.process is None else white - self.process.lost(white, transposed=True))

    def _by_band(self, flat: Array) -> Array:
        """Return x of shape (3 K, c) whitened by the band alone."""
        return self.solved(flat if self.rho is None else quasi_differences(flat, self.rho))

    def _back(self, white: Array) -> Array:
        """Return the transpose of `_by_band` applied to data (3 K, c)."""
        back = band_solve(self.factor, white, transposed=True)
        if self.rho is not None:
            blocks = back.reshape(len(self.rho), 3, -1)
            carried = np.einsum("kji,kjc->kic", self.rho[1:], blocks[1:])
            back = np.concatenate((blocks[:-1] - carried, blocks[-1:])).reshape(white.shape)
        return back

    def log_likelihood(self, innovations: Array) -> float:
        """Return the log density, nats, of residuals whose whitened values (3 K,) are given."""
        n = len(innovations)
        return float(-self.log_det - 0.5 * innovations @ innovations - 0.5 * n * np.log(2.0 * np.pi))


def interval_covariance(intervals: Intervals, q: Array, truth: TruthNoise) -> Array:
    """Return the marginal covariance (K, 3, 3) of residuals: noise q of the odometry plus the truth's at both ends."""
    total = q + unseen_piece(intervals)[0]
    for weight, diagonal in zip(truth_weights(truth), _single_pieces(intervals), strict=True):
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
    if intervals.memory.any():
        pieces = _correlated_pieces(intervals)
    else:
        a = _adjoint_of_inverse(intervals.truth_step)
        pieces = [
            _at_ends(intervals, a, kept @ intervals.start_shape @ kept, kept @ intervals.end_shape @ kept)
            for kept in _KEPT
        ]
    pieces.append(odometry_piece(intervals, _random_walk(intervals)))
    return pieces


def odometry_piece(intervals: Intervals, q: Array) -> tuple[Array, Array]:
    """Return the contribution of independent noise q (K, 3, 3) of each residual, as a pair like `truth_pieces`."""
    below = np.zeros_like(q[1:])
    rho = rho_of(intervals)
    if rho is None:
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


def _correlated_pieces(intervals: Intervals) -> list[tuple[Array, Array]]:
    """Return the contributions of unit correlated truth errors to quasi-differences, for position and heading."""
    start, end, b = map_axes(intervals)
    rho = rho_of(intervals)
    linked = intervals.linked[:, None, None]
    # the new error at the interval's end, and that of the previous end; the first of a chain has the full variance
    before = b + (0.0 if rho is None else rho @ start)
    fresh = 1.0 - intervals.memory**2
    earlier = np.where(intervals.linked, np.concatenate(([1.0], fresh[:-1])), 1.0)
    before = np.where(linked, before, b)
    pieces = []
    for kept in _KEPT:
        diagonal = _congruent(end, kept, fresh) + _congruent(before, kept, earlier)
        below = -(before @ kept @ np.swapaxes(np.concatenate((end[:1], end[:-1])), 1, 2)) * earlier[:, None, None]
        pieces.append((diagonal, (below * linked)[1:]))
    return pieces


def _single_pieces(intervals: Intervals) -> list[Array]:
    """Return the contributions of unit truth noise to the marginal covariance (K, 3, 3) of each residual."""
    if not intervals.memory.any():
        a = _adjoint_of_inverse(intervals.truth_step)
        at_ends = [
            _at_ends(intervals, a, kept @ intervals.start_shape @ kept, kept @ intervals.end_shape @ kept)
            for kept in _KEPT
        ]
        return [*(diagonal for diagonal, _ in at_ends), _random_walk(intervals)]
    _, end, b = map_axes(intervals)
    fresh, one = 1.0 - intervals.memory**2, np.ones(len(intervals))
    pieces = [_congruent(end, kept, fresh) + _congruent(b, kept, one) for kept in _KEPT]
    return [*pieces, _random_walk(intervals)]


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


def _congruent(m: Array, kept: Array, weight: Array) -> Array:
    """Return M kept M' (K, 3, 3), each multiplied by its weight (K,)."""
    return (m @ kept @ np.swapaxes(m, 1, 2)) * weight[:, None, None]


def _random_walk(intervals: Intervals) -> Array:
    walk = np.zeros((len(intervals), 3, 3))
    walk[:, [0, 1], [0, 1]] = (intervals.random_walk_level**2 * (intervals.end_s - intervals.start_s))[:, None]
    return walk


def quasi_differences(flat: Array, rho: Array) -> Array:
    """Return z_k = x_k - rho_k x_{k-1} of columns (3 K, c), each contiguous in memory."""
    x = flat.reshape(len(rho), 3, -1)
    z = x.copy()
    z[1:] -= rho[1:] @ x[:-1]
    return np.asfortranarray(z.reshape(flat.shape))


def unseen_piece(intervals: Intervals) -> tuple[Array, Array]:
    """Return the contribution of axes that the truth does not measure, as a pair like `truth_pieces`."""
    return _at_ends(intervals, _adjoint_of_inverse(intervals.truth_step), intervals.start_unseen, intervals.end_unseen)


def _at_ends(intervals: Intervals, a: Array, start: Array, end: Array) -> tuple[Array, Array]:
    """Return the contribution of truth covariances (K, 3, 3) at both ends of intervals, a pair like `truth_pieces`."""
    ar = a @ start
    return end + ar @ np.swapaxes(a, 1, 2), -ar[1:] * intervals.linked[1:, None, None]


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


def whitener(intervals: Intervals, q: Array, truth: TruthNoise) -> Whitener:
    """Return the whitener of the residuals from the noise of odometry and truth.

    Parameters
    ----------
    intervals : K intervals
    q : (K, 3, 3)
        Covariance that the odometry's noise law puts on each residual, m and rad.
    truth : noise of the truth
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


def factored(band: Array, rho: Array | None = None) -> Whitener:
    """Return the whitener of a lower banded covariance (6, 3 K) of residuals, or of their quasi-differences."""
    factor = band_factor(band)
    return Whitener(factor, half_log_det(factor), rho=rho)


def _adjoint_of_inverse(xyt: Array) -> Array:
    """Return Ad(D^-1) (K, 3, 3) of poses D (K, 3)."""
    c, s = np.cos(xyt[:, 2]), np.sin(xyt[:, 2])
    x, y = xyt[:, 0], xyt[:, 1]
    a = np.zeros((len(xyt), 3, 3))
    a[:, 0, 0], a[:, 0, 1], a[:, 1, 0], a[:, 1, 1], a[:, 2, 2] = c, s, -s, c, 1.0
    # J R^T d: displacement of the far end by a heading error
    a[:, 0, 2] = -(-s * x + c * y)
    a[:, 1, 2] = c * x + s * y
    return a

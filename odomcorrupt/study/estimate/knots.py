"""Knots of a random process: their whitened columns, and their posterior given whitened residuals.

The values of a Markov process at its knots have a banded precision, and so has their posterior, because a knot acts
only between its neighbours (Rue & Held 2005, Gaussian Markov Random Fields, sections 2.4 and 3.1). The covariance that
the process adds to the residuals is never formed.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from odomcorrupt.study.estimate.banded import band_factor, band_solve, diagonals, half_log_det, sparse_band

if TYPE_CHECKING:
    from collections.abc import Iterator

    from scipy.sparse import csr_array

    from odomcorrupt.geometry.se2 import Array


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

"""Knots of a random process after whitening, and the projection of data onto them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array


@dataclass(frozen=True, slots=True)
class WhitenedKnots:
    """L^-1 S of a sparse S (3 K, k), stored as blocks of columns over the rows in which they are not negligible.

    A knot acts only between its neighbours, and L^-1 decays after it. Dense columns would slow down every product.

    blocks : first row, first knot, and values (rows, knots) of each block
    count : number of knots k
    """

    blocks: tuple[tuple[int, int, Array], ...]
    count: int

    def inner(self, other: WhitenedKnots) -> Array:
        """Return S' V^-1 T (k, l) with other knots T, whitened by the same factor."""
        inner = np.zeros((self.count, other.count))
        for row, knot, own in self.blocks:
            for later, there, values in other.blocks:
                begin, end = max(row, later), min(row + len(own), later + len(values))
                if begin < end:
                    block = own[begin - row : end - row].T @ values[begin - later : end - later]
                    inner[knot : knot + own.shape[1], there : there + values.shape[1]] = block
        return inner

    def products(self, white: Array) -> Array:
        """Return S' L^-T z (k, c) of whitened data (3 K, c)."""
        products = np.zeros((self.count, white.shape[1]))
        for row, knot, values in self.blocks:
            products[knot : knot + values.shape[1]] = values.T @ white[row : row + len(values)]
        return products


@dataclass(frozen=True, slots=True)
class Shrunk:
    """Low-rank whitening correction of a random process: directions L^-1 S M and scale factors (Woodbury identity).

    The directions are orthonormal; whitened residuals are multiplied by one factor along each of them.
    They are never multiplied out: that would need the memory of hundreds of columns and most of the time of whitening.

    knots : L^-1 S (3 K, k), contribution of each knot of a process to each whitened residual
    mixing : M (k, m), weights of the knots in each direction
    factors : (m,) by which whitened data shrink along the directions
    taken : (k, k) M (I - factors) M'
    """

    knots: WhitenedKnots
    mixing: Array
    factors: Array
    taken: Array

    @classmethod
    def along(cls, knots: WhitenedKnots, mixing: Array, factors: Array) -> Self:
        """Return the directions given by knots and mixing, with the matrix `taken` computed."""
        return cls(knots, mixing, factors, (mixing * (1.0 - factors)) @ mixing.T)

    def lost(self, white: Array) -> Array:
        """Return the part that shrinkage along the directions removes from band-whitened data (3 K, c)."""
        lost, of_knots = np.zeros(white.shape, order="F"), self.taken @ self.knots.products(white)
        for row, knot, values in self.knots.blocks:
            lost[row : row + len(values)] += values @ of_knots[knot : knot + values.shape[1]]
        return lost

"""Knots of a random process after whitening: where they act, and what data lose along them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

__all__ = ["Shrunk", "WhitenedKnots"]


@dataclass(frozen=True, slots=True)
class WhitenedKnots:
    """L^-1 S of a sparse S (3 K, k), which fades behind each knot: blocks of columns over the rows where they are.

    A knot acts between its neighbours alone, and L^-1 forgets. Dense columns would be read in full for every product.

    blocks : first row, first knot, and values (rows, knots) of each block
    count : k
    """

    blocks: tuple[tuple[int, int, Array], ...]
    count: int

    def inner(self, other: WhitenedKnots) -> Array:
        """Return S' V^-1 T (k, l) with other knots T, whitened alike."""
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
    """Orthonormal directions L^-1 S M of whitened residuals along which a process makes them shrink.

    They are never multiplied out: that would take as much memory as hundreds of columns, and most of the time of
    everything that is whitened.

    knots : L^-1 S (3 K, k), what each knot of a process does to each whitened residual
    mixing : M (k, m) of the knots, for each direction
    factors : (m,) by which whitened data shrink along them
    taken : (k, k) what data lose of each knot for what they have of another
    """

    knots: WhitenedKnots
    mixing: Array
    factors: Array
    taken: Array

    @classmethod
    def along(cls, knots: WhitenedKnots, mixing: Array, factors: Array) -> Self:
        """Return the directions of knots and their mixing, with what is lost along them."""
        return cls(knots, mixing, factors, (mixing * (1.0 - factors)) @ mixing.T)

    def lost(self, white: Array) -> Array:
        """Return what data (3 K, c) that are whitened by the band alone lose along the directions."""
        lost, of_knots = np.zeros(white.shape, order="F"), self.taken @ self.knots.products(white)
        for row, knot, values in self.knots.blocks:
            lost[row : row + len(values)] += values @ of_knots[knot : knot + values.shape[1]]
        return lost

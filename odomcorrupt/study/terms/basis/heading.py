"""Basis functions of the heading: waves, which can be confined to the headings that were driven."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.study.terms.basis.basis_function import BasisFunction

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from odomcorrupt.geometry.motion import Motion
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.terms.basis.basis_function import Of

_BINS = 72
"""Number of bins of the heading, 5 degrees each."""
_LEAST = 0.005
"""Least fraction of the motion in a bin of headings that count as driven."""
_BRIDGED = 0.25
"""Largest gap between driven headings that a wave is interpolated over, as a fraction of its period."""


class _Arc(NamedTuple):
    """Headings whose difference from a middle, rad, has a larger cosine than `least`."""

    middle: float
    least: float

    @property
    def text(self) -> str:
        """Expression that is 1 at these headings and 0 at others."""
        return f"where(cos(theta {'-' if self.middle >= 0.0 else '+'} {abs(self.middle)}) > {self.least}, 1, 0)"

    @property
    def words(self) -> str:
        """The headings in words, in degrees."""
        middle, half = np.degrees((self.middle, np.arccos(self.least)))
        return f"{middle - half:.0f} to {middle + half:.0f}"


def wave_of_heading(times: int, arcs: Sequence[_Arc] = ()) -> BasisFunction:
    """Return a wave with a number of periods per turn, on arcs of headings if there are any, else on all headings."""
    inner = "theta" if times == 1 else f"{times} * theta"
    text, inside = f"k * cos({inner}) + m * sin({inner})", [arc.text for arc in arcs]
    if arcs:
        text = f"({text}) * {inside[0]}" if len(arcs) == 1 else f"({text}) * max({', '.join(inside)})"
    return BasisFunction(
        "heading",
        text,
        (_part(np.cos, times, arcs), _part(np.sin, times, arcs)),
        2,
        within=lambda theta, moved: wave_of_heading(times, _driven(theta, moved, _BRIDGED * 360.0 / times)),
        place=f"known from {' and '.join(arc.words for arc in arcs)} deg only" if arcs else "",
    )


def _part(function: Callable[[Array], Array], times: int, arcs: Sequence[_Arc]) -> Of:
    def value(m: Motion) -> Array:
        wave = function(times * m.theta)
        return wave * np.any([np.cos(m.theta - arc.middle) > arc.least for arc in arcs], axis=0) if arcs else wave

    return value


def _driven(theta: Array, moved: Array, bridged_deg: float) -> list[_Arc]:
    """Return the arcs of headings that were driven, joined across small gaps; none if that is a full turn.

    theta, moved : (n,) headings, rad, and the amount of motion at each
    bridged_deg : largest gap between headings of one arc
    """
    width = 360.0 / _BINS
    bins = (np.degrees(theta) // width).astype(np.int64) % _BINS
    part = np.bincount(bins, moved, _BINS)
    driven = np.flatnonzero(part > _LEAST * part.sum())
    following = np.append(driven[1:], driven[:1] + _BINS)
    last = np.flatnonzero((following - driven - 1) * width > bridged_deg)
    first = following[np.roll(last, 1)]
    half = 0.5 * np.radians(((driven[last] - first) % _BINS + 1) * width)
    middle = (np.radians(first * width) + half + np.pi) % (2.0 * np.pi) - np.pi
    return [_Arc(round(a, 3), round(b, 4)) for a, b in zip(middle.tolist(), np.cos(half).tolist(), strict=True)]

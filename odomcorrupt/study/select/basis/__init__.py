"""Laws of the unknown: simple functions of one driver that an error may follow where no known effect explains it.

A law is a rate: what moves (travel, its size, or turn) times a function of the driver. Where it acts, on a channel of
the body or on wheels, is said apart. Thresholds, places and moments are families, and whoever chooses among many pays
for it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from odomcorrupt.study.select.basis.basis_function import NUMBERS, Law
from odomcorrupt.study.select.basis.places import laws_of_headings, laws_of_places
from odomcorrupt.study.select.basis.times import laws_of_time
from odomcorrupt.study.select.basis.values import VALUES, laws_of_values

if TYPE_CHECKING:
    from collections.abc import Sequence

    from odomcorrupt.effects.effect import Motion

__all__ = ["NUMBERS", "VALUES", "Law", "laws"]


def laws(motions: Sequence[Motion]) -> list[Law]:
    """Return every law that is tried on these motions."""
    return [*laws_of_headings(), *laws_of_places(motions), *laws_of_time(motions), *laws_of_values(motions)]

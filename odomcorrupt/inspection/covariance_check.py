"""Check of the covariances of an odometry topic, while its messages are read."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.patch import PLANAR_BLOCK

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array

HUGE = 1e3
"""Smallest variance that means "unknown", m^2 or rad^2."""

ROUNDING = 1e-9
"""Tolerance of the symmetry and positive-semidefiniteness checks, relative to the largest variance."""


@dataclass(slots=True)
class CovarianceCheck:
    """Faults of many 6 x 6 covariances in x, y and yaw."""

    count: int = 0
    largest: float = 0.0
    zero: bool = True
    senseless: bool = False
    crooked: bool = False
    changed: bool = False
    _first: Array | None = None

    def take(self, flat: Array) -> None:
        """Check covariances (n, 36), row-major 6 x 6."""
        planar = flat[:, PLANAR_BLOCK]
        if not len(planar):
            return
        if self._first is None:
            self._first = planar[0].copy()
        self.count += len(planar)
        self.changed |= not bool(np.array_equal(planar, np.broadcast_to(self._first, planar.shape), equal_nan=True))
        self.zero &= not bool(planar.any())
        square = planar.reshape(-1, 3, 3)
        diagonal = np.diagonal(square, axis1=1, axis2=2)
        if not np.isfinite(planar).all() or (diagonal < 0.0).any():
            self.senseless = True
            return
        self.largest = max(self.largest, float(diagonal.max()))
        off = np.abs(square - square.transpose(0, 2, 1)).max(axis=(1, 2))
        allowed = ROUNDING * diagonal.max(axis=1)
        self.crooked |= bool((off > allowed).any() or (np.linalg.eigvalsh(square)[:, 0] < -allowed).any())

    def oddity(self, *, never_changes: bool) -> str | None:
        """Return a warning, or None; never_changes: whether constant covariances deserve one."""
        if self.zero:
            return "are all zero" if self.count else None
        if self.senseless:
            return "are negative or not numbers"
        if self.largest >= HUGE:
            return f'mean "unknown" (up to {self.largest:.3g})'
        if self.crooked:
            return "are not symmetric, or not positive"
        if never_changes and self.count > 1 and not self.changed:
            return "never change"
        return None

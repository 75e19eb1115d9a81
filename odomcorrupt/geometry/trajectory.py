"""Trajectories: planar poses with stamps, and their interpolation."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import interpolate, wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

UNKNOWN_M2, _FEW_KNOWN = 1.0, 0.1
"""Variance along an axis from which a pose counts as unknown, m^2; least fraction of poses that must be known."""


def distance_along(poses: Array) -> Array:
    """Return the distance (n,) travelled along poses (n, 2 or 3) since the first one, metres."""
    return np.concatenate(([0.0], np.cumsum(np.linalg.norm(np.diff(poses[:, :2], axis=0), axis=1))))


@dataclass(frozen=True, slots=True)
class Trajectory:
    """A trajectory of n poses with strictly increasing stamps.

    stamps_ns : (n,) int64, nanoseconds since 1970
    xyt : (n, 3) metres and radians, headings unwrapped; NaN headings in a truth of positions only
    covariance : (n, 3, 3) of each pose in its own axes, if the source reports it; only ratios matter, because the
        level is estimated; None if all poses are equally accurate
    relative : whether motions from pose to pose were measured and the poses are their sums; the errors of the motions
        are then mutually independent
    """

    stamps_ns: NDArray[np.int64]
    xyt: Array
    covariance: Array | None = None
    relative: bool = False

    def __post_init__(self) -> None:
        if len(self.stamps_ns) < 2:
            raise RecordingError(f"a trajectory: {len(self.stamps_ns)} poses; it takes two or more")
        if not np.all(np.diff(self.stamps_ns) > 0):
            raise RecordingError("a trajectory's stamps do not increase; sort them and drop duplicates first")

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Mask (n,) of poses known on all axes; all of them without covariances, or if hardly any would remain."""
        everywhere = np.ones(len(self), dtype=bool)
        if self.covariance is None:
            return everywhere
        worst = np.linalg.eigvalsh(self.covariance[:, :2, :2])[:, 1]
        known: NDArray[np.bool_] = worst < UNKNOWN_M2
        return known if known.mean() > _FEW_KNOWN else everywhere

    def only(self, rows: NDArray[np.bool_] | NDArray[np.int64] | slice) -> Trajectory:
        """Return the trajectory of some poses."""
        covariance = self.covariance[rows] if self.covariance is not None else None
        return replace(self, stamps_ns=self.stamps_ns[rows], xyt=self.xyt[rows], covariance=covariance)

    def seconds_since(self, origin_ns: int) -> Array:
        """Return the stamps as seconds (n,) since an integer origin, because float64 stamps since 1970 lose 256 ns."""
        return (self.stamps_ns - origin_ns).astype(np.float64) * 1e-9

    def at(self, t_s: Array, origin_ns: int) -> Array:
        """Return poses (m, 3) at times within the trajectory, interpolated on arcs."""
        left, fraction = self.place_of(t_s, origin_ns)
        return interpolate(self.xyt[left], self.xyt[left + 1], fraction)

    def heading_at(self, t_s: Array, origin_ns: int) -> Array:
        """Return only the headings (m,) of `at`, at a tenth of the cost."""
        return self.headings_between(*self.place_of(t_s, origin_ns))

    def headings_between(self, left: NDArray[np.int64], fraction: Array) -> Array:
        """Return headings (m,) interpolated from poses (m,) to their successors by fractions (m,), see `place_of`."""
        heading = self.xyt[:, 2]
        return heading[left] + fraction * wrap(heading[left + 1] - heading[left])

    def place_of(self, t_s: Array, origin_ns: int) -> tuple[NDArray[np.int64], Array]:
        """Return the indices (m,) of the poses before given times, and the fractions (m,) of the interval passed."""
        own = self.seconds_since(origin_ns)
        left = np.clip(np.searchsorted(own, t_s, side="right") - 1, 0, len(own) - 2)
        return left, (t_s - own[left]) / (own[left + 1] - own[left])

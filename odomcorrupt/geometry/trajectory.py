"""Trajectories: stamped poses, and stamps that were rounded.

Drivers and loggers round stamps to milliseconds or to hundredths of a second. Speeds and accelerations from such stamps
flicker, and so do effects that depend on them (a threshold of the acceleration). Learning and correction therefore both
restore the even grid of a periodic publisher.
"""

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


_ROUNDED_NS = (100_000_000, 50_000_000, 20_000_000, 10_000_000, 5_000_000, 2_000_000, 1_000_000)
_GAP = 1.5
"""Intervals longer than the median by this factor are gaps."""
_RANDOM = 0.5
"""Least relative standard deviation of the distances between long intervals if messages were lost: it is 0.7 to 1 for
random losses of up to half of the messages, and at most 0.4 if a slightly longer period is rounded."""
_WINDOW, _TOLERANCE, _MIN_IN = 101, 1.0, 0.99
"""Samples over which the rate is constant; largest deviation from the even grid in units of the resolution, because
rounding errors differ by less than that from their mean; and the least fraction of stamps within it."""


def resolution_s(stamps_ns: NDArray[np.int64]) -> float:
    """Return the resolution to which stamps (n,) are rounded, seconds; 0 if not rounded or not determinable.

    Stamps of a regular clock lie on a grid without being rounded, so intervals must vary for rounding to show. Those of
    such a clock with lost messages are whole periods.
    """
    steps = np.diff(stamps_ns)
    # least fraction of the stamps that are multiples of the resolution
    # tolerance of a multiple, nanoseconds, for stamps stored as float seconds since 1970 (steps of 238 ns)
    whole = next((r for r in _ROUNDED_NS if np.mean(_off(stamps_ns, r) <= 1_000) >= 0.999), 0) if len(steps) else 0
    if not whole:
        return 0.0
    usual = steps[steps < _GAP * np.median(steps) + whole]
    # least fraction of deviating intervals if stamps are rounded; those of a regular clock do not deviate
    varied = float(np.mean(np.abs(usual - np.median(usual)) > whole / 2)) > 0.02
    return whole * 1e-9 if varied and not _lost(steps, whole) else 0.0


def _lost(steps: NDArray[np.int64], whole_ns: int) -> bool:
    """Return whether intervals (n,) are those of a timer of period `whole_ns`, longer where messages were lost.

    Rounding makes a longer period of equal and double intervals at even distances, and jitter also makes shorter ones.
    """
    periods = np.rint(steps / whole_ns)
    if np.median(periods) != 1.0 or periods.min() < 1.0:
        return False
    between = np.diff(np.flatnonzero(periods > 1.0))
    return len(between) == 0 or bool(np.std(between) > _RANDOM * np.mean(between))


def _off(stamps_ns: NDArray[np.int64], whole_ns: int) -> NDArray[np.int64]:
    """Return the distances (n,) of stamps from the nearest multiple, nanoseconds."""
    past = stamps_ns % whole_ns
    return np.minimum(past, whole_ns - past)


def evened(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64] | None:
    """Return rounded stamps (n,) of a periodic publisher restored to an even grid with slowly varying period.

    None if stamps are not rounded, or differ from such a grid by more than rounding explains.
    """
    rounded_s = resolution_s(stamps_ns)
    if not rounded_s or len(stamps_ns) < 2 * _WINDOW:
        return None
    t_s = (stamps_ns - stamps_ns[0]).astype(np.float64) * 1e-9
    steps = np.diff(t_s)
    usual = steps[steps < _GAP * np.median(steps) + rounded_s]
    period_s = float(np.mean(usual))
    # shortest period, in units of the resolution, at which an even grid can be recognised in rounded stamps
    if period_s < 1.5 * rounded_s:
        return None
    off = np.zeros(len(t_s))
    for _ in range(2):  # the first mean includes intervals with a missing message and the first stamp's rounding
        count = _periods(t_s, period_s, float(np.median(off[:_WINDOW])))
        period_s = float(t_s[-1] / count[-1])
        off = t_s - count * period_s
    half = _WINDOW // 2
    # Extrapolated by a line fit at each end, because a single sample has the full rounding error.
    row = np.arange(_WINDOW)
    before = np.polyval(np.polyfit(row, off[:_WINDOW], 1), np.arange(-half, 0))
    after = np.polyval(np.polyfit(row, off[-_WINDOW:], 1), np.arange(_WINDOW, _WINDOW + half))
    padded = np.concatenate((before, off, after))
    smooth = np.convolve(padded, np.full(_WINDOW, 1.0 / _WINDOW), "valid")
    if np.mean(np.abs(off - smooth) < _TOLERANCE * rounded_s) < _MIN_IN:
        return None
    even = stamps_ns[0] + np.round((count * period_s + smooth) * 1e9).astype(np.int64)
    return even if np.all(np.diff(even) > 0) else None


def _periods(t_s: NDArray[np.float64], period_s: float, grid_s: float) -> NDArray[np.float64]:
    """Return the number of periods (n,) from `grid_s` to each stamp; messages may be missing.

    Stamps are compared with a grid that follows their mean, because a single interval differs from the period by up to
    the resolution, which may be half of the period.
    """
    count = np.zeros(len(t_s))
    for i, stamp_s in enumerate(t_s.tolist()):
        passed = round((stamp_s - grid_s) / period_s)
        passed = max(passed, 1) if i else passed
        count[i] = count[i - 1] + passed if i else passed
        grid_s += passed * period_s
        grid_s += 2.0 / _WINDOW * (stamp_s - grid_s)
    return count

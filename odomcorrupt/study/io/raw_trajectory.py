"""A trajectory as recorded: unsorted, unchecked poses with their source; and their order by stamps.

A few swapped or repeated stamps are sorted. A clock set back while recording (a restarted simulation, a looping bag)
gives two runs with the same stamps; sorting would interleave them, so only the longest stretch is kept. The same holds
for a clock set forward by more than an hour (a robot that receives the date after its start).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.trajectory import Trajectory

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import Origin

FEWEST = 20
"""Fewest poses, motions or angles of a source from which anything is learned."""
REPORTED_LAG_S = 0.01
"""Least lag of a gyro or of wheels against the odometry that is reported, seconds."""
CLOCK_S = 3.0
"""Largest clock offset that a study can find, and largest lag at which motions are compared for it, seconds."""


@dataclass(frozen=True, slots=True)
class Samples:
    """A trajectory of n poses, in recorded order.

    place : source in messages: "run.bag: /odom"
    name : topic, edge or file name without the bag
    frame : frame of the poses, "" if not given
    stamps_ns : (n,) int64, since 1970 or any other origin
    xyz : (n, 3) metres
    yaw_rad : (n,) as recorded, neither wrapped nor unwrapped; NaN if there is no heading
    log_ns : (n,) int64 times of recording; empty if unknown
    variance_m2 : (n,) reported variance of x plus y; empty if none is reported
    covariance : (n, 3, 3) of each pose in its own axes, if the source measured it
    child : the moving frame, "" if not given
    relative : whether motions from pose to pose were measured, see `Trajectory`
    notes : findings and removals so far, for reports
    geodetic_origin : origin of the frame, for satellite fixes
    localised : whether these are corrections of a localisation, whose errors are correlated along the path
    estimated : whether these are nav_msgs/Odometry messages, which estimators publish
    no_w : whether w is 0 in quaternions that are not of unit length
    """

    place: str
    name: str
    frame: str
    stamps_ns: NDArray[np.int64]
    xyz: Array
    yaw_rad: Array
    log_ns: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    variance_m2: Array = field(default_factory=lambda: np.zeros(0))
    notes: tuple[str, ...] = ()
    covariance: Array | None = None
    child: str = ""
    relative: bool = False
    geodetic_origin: Origin | None = None
    localised: bool = False
    estimated: bool = False
    no_w: bool = False

    @classmethod
    def planar(cls, place: str, name: str, stamps_ns: NDArray[np.int64], xyt: Array, **more: Any) -> Self:
        """Return the samples of poses (n, 3) in the plane; `more` as for the class."""
        xyz = np.column_stack((xyt[:, :2], np.zeros(len(xyt))))
        return cls(place=place, name=name, stamps_ns=stamps_ns, xyz=xyz, yaw_rad=xyt[:, 2], **({"frame": ""} | more))

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def headed(self) -> bool:
        """Whether the poses have headings."""
        return not bool(np.isnan(self.yaw_rad).all())

    @property
    def span_s(self) -> float:
        """Time from the first stamp to the last, seconds."""
        return float(self.stamps_ns[-1] - self.stamps_ns[0]) * 1e-9

    @property
    def t_s(self) -> Array:
        """Times since the first stamp (n,), seconds."""
        return self.seconds_since(int(self.stamps_ns[0]))

    def within(self, other: Samples) -> NDArray[np.bool_]:
        """Return which samples (n,) lie in the time of another trajectory."""
        return (self.stamps_ns >= other.stamps_ns[0]) & (self.stamps_ns <= other.stamps_ns[-1])

    def shared_s(self, other: Samples) -> float:
        """Return the time that both trajectories cover, seconds; negative if they are apart."""
        first, last = max(self.stamps_ns[0], other.stamps_ns[0]), min(self.stamps_ns[-1], other.stamps_ns[-1])
        return float(last - first) * 1e-9

    def seconds_since(self, origin_ns: int) -> Array:
        """Return the stamps as seconds (n,) since an integer origin."""
        return (self.stamps_ns - origin_ns).astype(np.float64) * 1e-9

    def only(self, rows: NDArray[np.bool_] | NDArray[np.int64], *notes: str) -> Samples:
        """Return the samples selected by a mask or by indices, with notes that give the reason."""
        return replace(
            self,
            stamps_ns=self.stamps_ns[rows],
            xyz=self.xyz[rows],
            yaw_rad=self.yaw_rad[rows],
            log_ns=self.log_ns[rows] if len(self.log_ns) else self.log_ns,
            variance_m2=self.variance_m2[rows] if len(self.variance_m2) else self.variance_m2,
            covariance=self.covariance[rows] if self.covariance is not None else None,
        ).noted(*notes)

    def stamped(self, stamps_ns: NDArray[np.int64]) -> Samples:
        """Return the same poses with other stamps (n,)."""
        return replace(self, stamps_ns=stamps_ns)

    def without_headings(self) -> Samples:
        """Return the samples without their headings."""
        return replace(self, yaw_rad=np.full(len(self), np.nan))

    def noted(self, *notes: str) -> Samples:
        """Return the samples with further notes."""
        return replace(self, notes=(*self.notes, *(f"{self.name}: {note}" for note in notes)))

    def trajectory(self) -> Trajectory:
        """Return stamps, x, y and unwrapped headings; the stamps must increase."""
        if len(self) < 2:
            raise RecordingError(f"{self.place} holds {len(self)} usable poses; many more are needed")
        yaw = np.unwrap(self.yaw_rad) if self.headed else self.yaw_rad
        xyt = np.concatenate((self.xyz[:, :2], yaw[:, None]), axis=1)
        return Trajectory(self.stamps_ns, xyt, self.covariance, self.relative)


def runs_of(mask: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Return the stretches of a mask (n,) that are true, as half-open index ranges."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False])).astype(np.int8)))
    return [(int(a), int(b)) for a, b in edges.reshape(-1, 2)]


_BACK_NS = 1_000_000_000  # smallest step back that begins another run
_FORWARD_NS = 3_600_000_000_000
_NEIGHBOURS = 5
READ_AS = "stamps read as"
NO_STAMPS = "no stamps in the messages, log times taken"
REPEATED = "have the stamp of the one before, while it moves: log times are taken"
SHARED, BACKWARDS = "share the stamp of another one, and are left out", "go back, and are sorted"
"""Stamps that are wrong as a rule: of most poses, and of one in a hundred."""
FAR_M = 1e9
"""Larger positions (metres) and headings (radians) count as invalid."""


class Order(NamedTuple):
    """Indices (k,) of the usable samples in the order of their stamps (k,), which increase; and notes on removals."""

    rows: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    notes: tuple[str, ...]


def order_of(stamps_ns: NDArray[np.int64], log_ns: NDArray[np.int64]) -> Order:
    """Return the order of samples with stamps (n,) in order of arrival; log times (n,) replace missing stamps."""
    rows = np.arange(len(stamps_ns))
    notes = []
    if len(log_ns):
        if not stamps_ns.any():
            stamps_ns = log_ns
            notes.append(NO_STAMPS)
        elif not stamps_ns.all():
            rows = np.flatnonzero(stamps_ns)
            notes.append(f"{len(stamps_ns) - len(rows)} poses without a stamp left out")
    stamps = stamps_ns[rows]
    starts = _set_back(stamps)
    if len(starts):
        pieces = np.split(rows, starts)
        rows = max(pieces, key=len)
        left = sum(map(len, pieces)) - len(rows)
        notes.append(f"its clock is set back {len(starts)} times: the longest stretch kept, {left} poses left out")
    stamps = stamps_ns[rows]
    swapped = int(np.sum(np.diff(stamps) < 0))
    unique, index = np.unique(stamps, return_index=True)
    rows = rows[index]
    if swapped:
        many = swapped > len(stamps) / 100.0
        notes.append(f"{swapped} of its stamps {BACKWARDS}" if many else f"{swapped} stamps out of order sorted")
    if again := len(stamps) - len(unique):
        many = again > len(stamps) / 2.0
        notes.append(f"{again} of its poses {SHARED}" if many else f"{again} poses with duplicate stamps left out")
    ahead = np.flatnonzero(np.diff(unique) > _FORWARD_NS) + 1
    if len(ahead):
        kept = max(np.split(np.arange(len(unique)), ahead), key=len)
        notes.append(f"its stamps jump by more than an hour: {len(unique) - len(kept)} poses left out")
        rows, unique = rows[kept], unique[kept]
    return Order(rows, unique, tuple(notes))


def in_order(samples: Samples) -> Samples:
    """Return the samples with finite values, in order of increasing stamps.

    Raises
    ------
    RecordingError
        If fewer than two remain.
    """
    found = len(samples)
    if not found:
        raise RecordingError(f"{samples.place} holds no message; name another topic")
    # comparisons with NaN are false
    good = np.asarray((np.abs(samples.xyz) < FAR_M).all(axis=1))
    if not good.any():
        raise RecordingError(f"{samples.place}: none of its {found} positions is a number; name another source")
    if not good.all():
        samples = samples.only(good, f"{np.sum(~good)} positions that are not numbers left out")
    headless: NDArray[np.bool_] = ~(np.abs(samples.yaw_rad) < FAR_M)
    if headless.all():
        samples = samples.without_headings()
    elif headless.any():
        samples = samples.only(~headless, f"{np.sum(headless)} poses without a heading left out")
    moved, same = np.diff(samples.xyz[:, :2], axis=0).any(axis=1), np.diff(samples.stamps_ns) == 0
    if len(samples.log_ns):  # milliseconds or microseconds in the nanoseconds are as good as none
        same |= np.abs(np.diff(samples.stamps_ns)) < 0.01 * np.diff(samples.log_ns)
    if len(samples.log_ns) and samples.stamps_ns.any() and (moved & same).sum() > moved.sum() / 2.0:
        samples = samples.noted(f"{same.sum()} of its poses {REPEATED}").stamped(samples.log_ns)
    order = order_of(samples.stamps_ns, samples.log_ns)
    if len(order.rows) < 2:
        raise RecordingError(
            f"{samples.place}: {found} poses, {len(order.rows)} of them with a unique stamp and finite numbers; "
            "many more are needed"
        )
    return samples.only(order.rows, *order.notes).stamped(order.stamps_ns)


def _set_back(stamps: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the start indices of stretches that begin more than a second before the preceding stamps."""
    if len(stamps) < 2 * _NEIGHBOURS:
        return np.zeros(0, dtype=np.int64)
    window = np.lib.stride_tricks.sliding_window_view(stamps, _NEIGHBOURS)
    before, after = np.median(window[:-_NEIGHBOURS], axis=1), window[_NEIGHBOURS:].max(axis=1)
    # float64 medians of nanoseconds are off by up to 256 ns, which is negligible here
    behind = after < before - _BACK_NS
    places: NDArray[np.int64] = np.flatnonzero(behind) + _NEIGHBOURS
    return places[stamps[places] < stamps[places - 1] - _BACK_NS]

"""A trajectory as recorded: unsorted, unchecked poses with their source."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.trajectory import Trajectory

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import Origin

LEAST = 2


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
    """

    place: str
    name: str
    frame: str
    stamps_ns: NDArray[np.int64]
    xyz: Array
    yaw_rad: Array
    log_ns: NDArray[np.int64]
    variance_m2: Array
    notes: tuple[str, ...] = ()
    covariance: Array | None = None
    child: str = ""
    relative: bool = False
    geodetic_origin: Origin | None = None
    localised: bool = False

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
        if len(self) < LEAST:
            raise RecordingError(f"{self.place} holds {len(self)} usable poses; it takes many more")
        yaw = np.unwrap(self.yaw_rad) if self.headed else self.yaw_rad
        xyt = np.concatenate((self.xyz[:, :2], yaw[:, None]), axis=1)
        return Trajectory(self.stamps_ns, xyt, self.covariance, self.relative)

"""Samples: poses as somebody recorded them, before anything is put in order."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.study.io.recording import Trajectory

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import Origin

__all__ = ["Samples"]

LEAST = 2


@dataclass(frozen=True, slots=True)
class Samples:
    """n poses in the order in which they were recorded.

    place : what they were read from, for messages: "run.bag: /odom"
    name : the topic, edge or file alone
    frame : the frame they are given in, "" where nobody says
    stamps_ns : (n,) int64, since 1970 or since anything
    xyz : (n, 3) metres
    yaw_rad : (n,) as recorded, neither wrapped nor unwrapped; NaN where there is no heading
    log_ns : (n,) int64, when they were recorded; empty where nobody says
    variance_m2 : (n,) what the recorder claims of x plus y; empty where it claims nothing
    covariance : (n, 3, 3) of each pose in its own axes, where its source measured it
    child : the frame that moves, "" where nobody says
    notes : what was noticed or left out so far, in words
    geodetic_origin : of its frame, where it was satellite fixes
    localised : whether it is the corrections of a localisation, whose errors are alike over some length of path
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
    geodetic_origin: Origin | None = None
    localised: bool = False

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def headed(self) -> bool:
        """Whether there are headings."""
        return not bool(np.isnan(self.yaw_rad).all())

    @property
    def span_s(self) -> float:
        """Time from the first stamp to the last, seconds."""
        return float(self.stamps_ns[-1] - self.stamps_ns[0]) * 1e-9

    def seconds_since(self, origin_ns: int) -> Array:
        """Return the stamps as seconds (n,) since an integer origin."""
        return (self.stamps_ns - origin_ns).astype(np.float64) * 1e-9

    def only(self, rows: NDArray[np.bool_] | NDArray[np.int64], *notes: str) -> Samples:
        """Return some of the samples, by mask or by index, with notes that say why."""
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
        """Return the positions alone."""
        return replace(self, yaw_rad=np.full(len(self), np.nan))

    def noted(self, *notes: str) -> Samples:
        """Return the same samples with more said about them."""
        return replace(self, notes=(*self.notes, *(f"{self.name}: {note}" for note in notes)))

    def trajectory(self) -> Trajectory:
        """Return stamps, x, y and unwrapped headings; the stamps must grow."""
        if len(self) < LEAST:
            raise RecordingError(f"{self.place} holds {len(self)} usable poses; it takes many more")
        yaw = np.unwrap(self.yaw_rad) if self.headed else self.yaw_rad
        xyt = np.concatenate((self.xyz[:, :2], yaw[:, None]), axis=1)
        return Trajectory(self.stamps_ns, xyt, self.covariance)

"""Laser sweeps: the returns of one turn of a planar laser, each with its time."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.laser.even_stamps import even_stamps

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.mapping.frames import Mount

MOST_RETURNS = 720
"""Number of returns to which denser sweeps are thinned: more cost time and add little information."""
_LEAST_S = 2e-3
"""Median deviation from even spacing below which stamps are kept, s: a robot moves a millimetre or two in that time."""


@dataclass(frozen=True, slots=True)
class Sweep:
    """The m returns of one sweep.

    stamp_ns : stamp of the sweep's message
    xy : (m, 2) float32, positions of the returns in the laser's frame, metres, in the order of their bearings
    after_s : (m,) float32, time of each return after the stamp, seconds
    """

    stamp_ns: int
    xy: NDArray[np.float32]
    after_s: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.xy)

    def only(self, kept: NDArray[np.bool_]) -> Sweep:
        """Return the sweep with the returns selected by a mask (m,)."""
        return replace(self, xy=self.xy[kept], after_s=self.after_s[kept])


@dataclass(frozen=True, slots=True)
class Sweeps:
    """All sweeps of one topic, in order of increasing stamps.

    place : name of the bag and topic for messages, such as "run.bag: /scan"
    topic, frame_id : topic of the sweeps, and frame of the laser
    sweeps : the sweeps, with returns in the laser's plane, counter-clockwise seen from above the plane
    field_of_view_rad : angle between the first and the last bearing
    log_ns : (n,) log time of each sweep
    mount : mounting of the laser on the robot, None if TF does not have it
    notes : messages about findings and omissions
    by_scan_time : whether the times within the sweeps come from scan_time alone, with a time_increment of 0, as for
        lasers whose beams are simultaneous
    """

    place: str
    topic: str
    frame_id: str
    sweeps: tuple[Sweep, ...]
    field_of_view_rad: float
    log_ns: NDArray[np.int64]
    mount: Mount | None
    notes: tuple[str, ...] = ()
    by_scan_time: bool = False

    def __len__(self) -> int:
        return len(self.sweeps)

    def at_once(self) -> Sweeps:
        """Return the sweeps with all returns at the time of the stamp."""
        return replace(self, sweeps=tuple(replace(s, after_s=np.zeros_like(s.after_s)) for s in self.sweeps))

    def evened(self) -> Sweeps | None:
        """Return the sweeps with evenly spaced stamps, as of a laser at constant rate; None if they nearly are already.

        Stamps of arrival include each sweep's delay; see `even_stamps`.
        """
        stamps = self.stamps_ns
        even = even_stamps(stamps)
        if not len(self) or np.median(np.abs(even - stamps)) < _LEAST_S * 1e9 or np.any(np.diff(even) <= 0):
            return None
        moved = zip(self.sweeps, even.tolist(), strict=True)
        return replace(self, sweeps=tuple(replace(sweep, stamp_ns=stamp) for sweep, stamp in moved))

    @property
    def stamps_ns(self) -> NDArray[np.int64]:
        """Stamps (n,) of the sweeps."""
        return np.array([sweep.stamp_ns for sweep in self.sweeps], dtype=np.int64)

    @property
    def period_s(self) -> float:
        """Median time between two sweeps, seconds."""
        return float(np.median(np.diff(self.stamps_ns))) * 1e-9 if len(self) > 1 else 0.0

    def middle_s(self, origin_ns: int) -> Array:
        """Return the times (n,) of the middles of the sweeps, seconds since an integer origin."""
        half = np.array([0.5 * float(s.after_s.min() + s.after_s.max()) if len(s) else 0.0 for s in self.sweeps])
        stamps: Array = (self.stamps_ns - origin_ns).astype(np.float64) * 1e-9
        return stamps + half

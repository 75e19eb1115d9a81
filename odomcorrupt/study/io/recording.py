"""Trajectories and recordings: what a robot's odometry said, and where the robot really was."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.drive_types import AUTO
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import interpolate, wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.model.motion_model import Origin

__all__ = ["UNKNOWN_M2", "Recording", "Trajectory", "TruthField"]

UNKNOWN_M2, _FEW_KNOWN = 1.0, 0.1
"""Variance of a pose of which nothing is known along an axis; and the share of poses that must be known."""


@dataclass(frozen=True, slots=True)
class Trajectory:
    """n poses with strictly growing stamps.

    stamps_ns : (n,) int64, nanoseconds since 1970
    xyt : (n, 3) metres and radians, headings unwrapped; NaN headings in a truth of positions alone
    covariance : (n, 3, 3) of each pose in its own axes, where its source says it: only their shapes count, the level
        is estimated; None where all poses are equally good
    relative : whether motions from pose to pose were measured and the poses are their sum, so that each motion has an
        error of its own, independent of the others'
    """

    stamps_ns: NDArray[np.int64]
    xyt: Array
    covariance: Array | None = None
    relative: bool = False

    def __post_init__(self) -> None:
        if len(self.stamps_ns) < 2:
            raise RecordingError(f"a trajectory: {len(self.stamps_ns)} poses; it takes two or more")
        if not np.all(np.diff(self.stamps_ns) > 0):
            raise RecordingError("a trajectory's stamps do not grow; sort them and drop repeats first")

    def __len__(self) -> int:
        return len(self.stamps_ns)

    @property
    def known(self) -> NDArray[np.bool_]:
        """Which poses (n,) are known on all axes: all, where their source says nothing, or nearly none of them is."""
        everywhere = np.ones(len(self), dtype=bool)
        if self.covariance is None:
            return everywhere
        worst = np.linalg.eigvalsh(self.covariance[:, :2, :2])[:, 1]
        known: NDArray[np.bool_] = worst < UNKNOWN_M2
        return known if known.mean() > _FEW_KNOWN else everywhere

    def seconds_since(self, origin_ns: int) -> Array:
        """Return the stamps as seconds (n,) since an integer origin: float64 stamps since 1970 lose 256 ns."""
        return (self.stamps_ns - origin_ns).astype(np.float64) * 1e-9

    def at(self, t_s: Array, origin_ns: int) -> Array:
        """Return poses (m, 3) at times within the trajectory, on arcs between neighbours."""
        left, fraction = self.place_of(t_s, origin_ns)
        return interpolate(self.xyt[left], self.xyt[left + 1], fraction)

    def heading_at(self, t_s: Array, origin_ns: int) -> Array:
        """Return the headings (m,) of `at`, alone: they cost a tenth."""
        return self.headings_between(*self.place_of(t_s, origin_ns))

    def headings_between(self, left: NDArray[np.int64], fraction: Array) -> Array:
        """Return the headings (m,) at parts of the way (m,) from poses (m,) to the next ones, see `place_of`."""
        heading = self.xyt[:, 2]
        return heading[left] + fraction * wrap(heading[left + 1] - heading[left])

    def place_of(self, t_s: Array, origin_ns: int) -> tuple[NDArray[np.int64], Array]:
        """Return the poses (m,) that times come after, and the parts of the way to the next ones."""
        own = self.seconds_since(origin_ns)
        left = np.clip(np.searchsorted(own, t_s, side="right") - 1, 0, len(own) - 2)
        return left, (t_s - own[left]) / (own[left + 1] - own[left])


@dataclass(frozen=True, slots=True)
class TruthField:
    """Errors of a localisation: independent ones of each pose, and a Gaussian field that belongs to places on the map.

    own_xy_m, own_yaw_rad : standard deviations of the independent errors
    xy_m, yaw_rad, length_m : standard deviations of the field, and over which distance it is alike
    """

    own_xy_m: float
    own_yaw_rad: float
    xy_m: float
    yaw_rad: float
    length_m: float


@dataclass(frozen=True, slots=True)
class Recording:
    """One run of a robot: its odometry and the truth, each on its own clock, in its own frame.

    origin_ns : what float times count from: the odometry's first stamp as it was recorded
    track_m : the robot's nominal track where it is known
    drive_type : how its wheels steer it, see `drive_types`; "auto" where nobody said it
    notes : what reading it left out or noticed, in words
    clock : names the clock, and with it the origin, that stretches of one run share; empty: one of its own
    heading_error_rad : where the truth has only positions, how far off the headings given to it may be
    truth_scale_error : standard deviation of a scale error that all lengths of the truth may share (a laser's)
    positioned : whether the truth measured positions; a gyro's are the odometry's travel along its headings
    turn_scale_error : standard deviation of a scale error that all turns of the truth may share (a gyro's)
    turn_bias_error : standard deviation of an offset that all yaw rates of the truth may share, rad/s
    heading_source : what a gyro in the bag shows the odometry's heading to come from: "wheels", "gyro", or "" unknown
    geodetic_origin : of the truth's frame, where it was satellite fixes
    localised : whether the truth is a localisation's (AMCL, SLAM), whose errors are alike over some length of path
    of_base : whether the truth is a localisation's of the very frame whose odometry it is (map -> odom -> base_link),
        so that it has no lever arm and no mounting yaw
    truth_correlation_m : way over which errors of the truth fade to 1/e of their correlation; 0: they are independent
        of each other; None: not estimated yet, and taken for 0
    truth_field : which of the truth's errors belong to places, where that explains them better
    pulled_per_s : how fast the odometry's errors fade towards the truth, as those of a filter do that is given poses
    pose_corrections : steps of such a filter that were found in the odometry and taken out of it
    truth_level : by how much its truth is noisier than that of the first recording of a study, position and heading
    odometry_topic : where its odometry was found; "" where it was no topic
    stamp_error_s : standard deviation of an offset between the two clocks that rounded stamps hide, seconds
    """

    name: str
    odometry: Trajectory
    truth: Trajectory
    origin_ns: int
    track_m: float | None = None
    notes: tuple[str, ...] = ()
    heading_error_rad: float | None = None
    clock: str = ""
    truth_scale_error: float = 0.0
    positioned: bool = True
    turn_scale_error: float = 0.0
    turn_bias_error: float = 0.0
    heading_source: str = ""

    @property
    def matched(self) -> bool:
        """Whether the truth comes from scans matched with a map."""
        return self.truth.covariance is not None and not self.truth.relative

    @property
    def axes(self) -> list[int]:
        """Which of along (0), across (1) and yaw (2) the truth measured."""
        return [*([0, 1] if self.positioned else []), *([2] if self.headed else [])]

    geodetic_origin: Origin | None = None
    truth_level: tuple[float, float] = (1.0, 1.0)
    stamp_error_s: float = 0.0
    localised: bool = False
    of_base: bool = False
    truth_correlation_m: float | None = None
    truth_field: TruthField | None = None
    pulled_per_s: float = 0.0
    pose_corrections: int = 0
    drive_type: str = AUTO
    odometry_topic: str = ""

    @property
    def headed(self) -> bool:
        """Whether the truth measured headings: those that were given to positions are none."""
        return self.heading_error_rad is None and bool(np.isfinite(self.truth.xyt[:, 2]).all())

    @property
    def odometry_s(self) -> Array:
        """Times of the odometry (n,), seconds since the origin."""
        return self.odometry.seconds_since(self.origin_ns)

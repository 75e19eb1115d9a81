"""Recordings: a robot's odometry with the reference trajectory (truth) of the same run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.drive_types import AUTO
from odomcorrupt.geometry.se2 import Increments, accumulate, increments

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.model.motion_model import MotionModel, Origin


class Mistake(NamedTuple):
    """A plain mistake that was found.

    name : of its row of the table in `first_look`
    said, causes, change : what is seen; usual causes, the likeliest first; what to change
    then : how the study goes on
    """

    name: str
    said: str
    causes: str
    change: str
    then: str = ""

    @property
    def sentence(self) -> str:
        """All of it in one line."""
        return "; ".join(filter(None, (self.said, f"usual causes: {self.causes}", self.change, self.then)))


@dataclass(frozen=True, slots=True)
class Recording:
    """One run of a robot: its odometry and the truth, each with its own clock and frame.

    origin_ns : origin of times in float seconds: the odometry's first stamp as recorded
    track_m : the robot's nominal track, if known
    drive_type : steering of the wheels, see `drive_types`; "auto" if not given
    notes : removals and findings of the reader, for reports
    alerts : findings of the reader that every summary shows
    mistakes : plain mistakes of wiring, units, signs and axes; undone but for factors
    gains : ratios of truth to odometry in travel and turn that a first look found, 1 if about right
    ratios : what a first look finds of travel and turns, in words
    clock : name of the clock, and of the origin, shared by stretches of one run; "" if not shared
    heading_error_rad : for a truth of positions only, upper bound of the error of the headings estimated for it: as if
        all that alignment leaves were one error
    truth_scale_error : standard deviation of a scale error common to all lengths of the truth (of a laser, or of a map)
    positioned : whether the truth measured positions; a gyro's are the odometry's travel along the gyro's headings
    turn_scale_error : standard deviation of a scale error common to all turns of the truth (a gyro's)
    turn_bias_walk : random walk of the bias of a gyro as the truth, rad/s/sqrt(s); None if not estimated yet
    heading_source : source of the odometry's heading according to a gyro: "wheels", "gyro", or "" if unknown
    geodetic_origin : origin of the truth's frame, for satellite fixes
    frame : name of the truth's frame if it is that of one run only, such as a laser's map, in which places and headings
        of other runs have no meaning; "" if runs share it
    localised : whether the truth is a localisation's (AMCL, SLAM), whose errors are correlated along the path
    in_map : whether SLAM or a localisation made the truth, also if it has poses at all times
    of_base : whether the truth is a localisation of the odometry's own frame (map -> odom -> base_link), and so has
        neither lever arm nor mounting yaw
    truth_correlation_m : travel over which the truth's errors decorrelate to 1/e; 0 if independent; None if not
        estimated yet, which counts as 0
    pulled_per_s : decay rate of the odometry's errors towards the truth, as of a filter that receives poses, 1/s
    pose_corrections : number of steps of such a filter that were removed from the odometry
    truth_level : noise of the truth relative to the median of a study's recordings, position and heading
    yaw_dead_band_radps : threshold below which the odometry's yaw rate reads zero while the truth turns; 0 if none
    odometry_topic : topic of the odometry; "" if it was no topic
    stamp_error_s : standard deviation of a clock offset hidden by rounded stamps, seconds
    stamp_jitter_s : standard deviation of stamps of arrival, seconds; they are late by about as much
    sketch : see `sketch_of`, of the odometry as read; "" if it is computed from the present odometry
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
    turn_bias_walk: float | None = None
    heading_source: str = ""
    geodetic_origin: Origin | None = None
    frame: str = ""
    truth_level: tuple[float, float] = (1.0, 1.0)
    stamp_error_s: float = 0.0
    stamp_jitter_s: float = 0.0
    localised: bool = False
    in_map: bool = False
    of_base: bool = False
    truth_correlation_m: float | None = None
    pulled_per_s: float = 0.0
    pose_corrections: int = 0
    yaw_dead_band_radps: float = 0.0
    drive_type: str = AUTO
    odometry_topic: str = ""
    alerts: tuple[str, ...] = ()
    sketch: str = ""
    mistakes: tuple[Mistake, ...] = ()
    gains: tuple[float, float] = (1.0, 1.0)
    ratios: str = ""

    def with_odometry(self, odometry: Trajectory) -> Recording:
        """Return the recording with its odometry processed, and the content as read."""
        return replace(self, odometry=odometry, sketch=content_of(self))

    def multiplied(self, travel: float, turn: float) -> Recording:
        """Return the recording with the odometry's travel and turns multiplied by two factors; by its gains: undone."""
        if travel == turn == 1.0:
            return self
        rows = increments(self.odometry.xyt).rows * [travel, travel, turn]
        odometry = replace(self.odometry, xyt=accumulate(self.odometry.xyt[0], Increments.of_rows(rows)))
        return replace(self.with_odometry(odometry), gains=(self.gains[0] / travel, self.gains[1] / turn))

    @property
    def matched(self) -> bool:
        """Whether the truth comes from scan matching."""
        return self.truth.covariance is not None and not self.truth.relative

    @property
    def axes(self) -> list[int]:
        """Axes that the truth measured: along (0), across (1), yaw (2)."""
        return [*([0, 1] if self.positioned else []), *([2] if self.headed else [])]

    @property
    def headed(self) -> bool:
        """Whether the truth measured headings; headings estimated for a truth of positions do not count."""
        return self.heading_error_rad is None and bool(np.isfinite(self.truth.xyt[:, 2]).all())

    @property
    def odometry_s(self) -> Array:
        """Times of the odometry (n,), seconds since the origin."""
        return self.odometry.seconds_since(self.origin_ns)

    @property
    def truth_s(self) -> Array:
        """Times of the truth (t,), seconds since the origin."""
        return self.truth.seconds_since(self.origin_ns)

    @property
    def within_odometry(self) -> NDArray[np.bool_]:
        """Mask (t,) of the truth's samples in the time of the odometry."""
        first_s, last_s = self.odometry_s[[0, -1]].tolist()
        return (self.truth_s >= first_s) & (self.truth_s <= last_s)

    @property
    def travel_m(self) -> float:
        """Largest distance between two positions on the signed path of the odometry along its own axes, m.

        Noise adds up to little, however long the robot turns on the spot.
        """
        steps = increments(self.odometry.xyt)
        along, across = (float(np.ptp(np.cumsum(own))) for own in (steps.ds_m, steps.dl_m))
        return float(np.hypot(along, across))


def shared_frame(recordings: Sequence[Recording]) -> str | None:
    """Return the `frame` that all recordings have; None if they differ, so that no place is common to them."""
    frames = {recording.frame for recording in recordings}
    return frames.pop() if len(frames) == 1 else None


def ranks_of(recordings: Sequence[Recording]) -> NDArray[np.int64]:
    """Return the ranks (R,) of recordings by the last pose and first stamp of their odometry: in any order the same."""
    keys = [(*r.odometry.xyt[-1].tolist(), int(r.odometry.stamps_ns[0])) for r in recordings]
    return np.argsort(sorted(range(len(keys)), key=keys.__getitem__))


_SKETCH, _DIGITS = 16, 8
"""Number of hashes in a sketch, of which half a recording has none in one of 65 000 cases; digits of each."""


def sketch_of(odometry: Trajectory) -> str:
    """Return what identifies a recording, or a part of it, by its content: the least hashes of its moving poses.

    Bottom-k sketch (Broder 1997, On the resemblance and containment of documents): two drives share no hash, a drive
    and a part of it share some.
    """
    rows = np.column_stack((odometry.stamps_ns.view(np.uint64), np.ascontiguousarray(odometry.xyt).view(np.uint64)))
    rows = rows[1:][(np.diff(odometry.xyt, axis=0) != 0.0).any(axis=1)]
    hashes = np.zeros(len(rows), dtype=np.uint64)
    for column in rows.T:  # the finaliser of SplitMix64 (Steele, Lea & Flood 2014) on each column
        hashes = (hashes ^ column) + np.uint64(0x9E3779B97F4A7C15)
        hashes = (hashes ^ (hashes >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        hashes = (hashes ^ (hashes >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        hashes ^= hashes >> np.uint64(31)
    return "".join(f"{one:0{_DIGITS}x}" for one in np.unique(hashes >> np.uint64(32))[:_SKETCH].tolist())


def content_of(recording: Recording) -> str:
    """Return the `sketch_of` a recording's odometry as it was read."""
    return recording.sketch or sketch_of(recording.odometry)


def was_fitted(model: MotionModel, recording: Recording) -> bool:
    """Return whether a model was fitted to a recording, or to one that shares a part with it, whatever their names."""
    own = _hashes(content_of(recording))
    fitted = model.source.get("fitted", [])
    return any(not own.isdisjoint(_hashes(one)) for one in fitted) if isinstance(fitted, list) else False


def _hashes(sketch: str) -> set[str]:
    return {sketch[i : i + _DIGITS] for i in range(0, len(sketch), _DIGITS)}

"""Sweeps of a laser: read from scans and point clouds, and corrected for the motion during each."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import SCAN
from odomcorrupt.errors import RecordingError, TopicError
from odomcorrupt.geometry.se2 import between, compose
from odomcorrupt.laser.icp import LEAST_RETURNS
from odomcorrupt.mapping.messages import CLOUD, ScanMessage, read_lasers

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import BagReader
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.mapping.messages import CloudMessage, Mount


_KNOTS = 17
"""Number of poses per sweep, odd so that the middle is one of them; motion between them is uniform. With 5 in 0.2 s,
heading errors are 2e-4 s^2 times the angular acceleration, which resembles slip at starts and stops."""


@dataclass(frozen=True, slots=True)
class Motion:
    """Odometry as a function of the laser's time.

    lag_s : offset added to the laser's times to get the odometry's, seconds
    mount : (3,) the laser's pose on the robot, m and rad
    turn_ratio : turns of the laser divided by those of the odometry. If the odometry's turns are 4 % wrong, a return
        3 m away is displaced by 1 cm within a sweep at 1 rad/s. This resembles slip to the side, and a scale that
        differs between directions
    """

    odometry: Trajectory
    origin_ns: int
    lag_s: float
    mount: Array
    turn_ratio: float = 1.0

    def robot(self, t_s: Array) -> Array:
        """Return the odometry's poses (n, 3) at times (n,) of the laser; held at both ends."""
        own = self.odometry.seconds_since(self.origin_ns)
        return self.odometry.at(np.clip(t_s + self.lag_s, own[0], own[-1]), self.origin_ns)

    def laser(self, t_s: Array) -> Array:
        """Return the laser's poses (n, 3) in the odometry's frame at times (n,) of the laser."""
        return compose(self.robot(t_s), self.mount)


class Deskewing:
    """Sweeps corrected for motion: each return is moved to its position relative to the laser at the sweep's middle.

    The laser's poses within all chosen sweeps are interpolated in one call, which is much faster than one by one.

    turn_s : see `Calibration`; the time of the middle of each sweep is unchanged
    rows : (k,) indices of the sweeps that will be used; all by default
    """

    def __init__(
        self,
        sweeps: Sweeps,
        motion: Motion,
        *,
        mirrored: bool,
        turn_s: float = 0.0,
        rows: NDArray[np.int64] | None = None,
    ) -> None:
        self._sweeps, self._mirrored, self._turn_s = sweeps.sweeps, mirrored, turn_s
        rows = np.arange(len(sweeps)) if rows is None else np.unique(rows)
        self._place = {int(row): place for place, row in enumerate(rows)}
        spans = np.array([self._span(int(row)) for row in rows]).reshape(-1, 2)
        stamps_s = (sweeps.stamps_ns[rows] - motion.origin_ns).astype(np.float64) * 1e-9
        self._knots_s = spans[:, :1] + (spans[:, 1:] - spans[:, :1]) * (np.arange(_KNOTS) / (_KNOTS - 1.0))
        poses = motion.laser((stamps_s[:, None] + self._knots_s).ravel()).reshape(-1, _KNOTS, 3)
        middle = np.repeat(poses[:, _KNOTS // 2], _KNOTS, axis=0)
        self._relative = between(middle, poses.reshape(-1, 3)).reshape(-1, _KNOTS, 3) * (1.0, 1.0, motion.turn_ratio)

    def __getitem__(self, row: int) -> Array:
        """Return the corrected returns (m, 2) of a sweep, m."""
        sweep, place = self._sweeps[row], self._place[row]
        xy = sweep.xy.astype(np.float64)
        if self._mirrored:
            xy[:, 1] = -xy[:, 1]
        knots_s = self._knots_s[place]
        if knots_s[0] == knots_s[-1]:
            return xy
        after_s = self._after_s(row)
        relative = self._relative[place]
        x, y, yaw = (np.interp(after_s, knots_s, relative[:, i]) for i in range(3))
        c, s = np.cos(yaw), np.sin(yaw)
        return np.stack((x + c * xy[:, 0] - s * xy[:, 1], y + s * xy[:, 0] + c * xy[:, 1]), axis=1)

    def _after_s(self, row: int) -> Array:
        """Return the times (m,) of a sweep's returns after its stamp, seconds."""
        sweep = self._sweeps[row]
        after_s = sweep.after_s.astype(np.float64)
        if self._turn_s == 0.0 or not len(after_s):
            return after_s
        bearing = np.unwrap(np.arctan2(sweep.xy[:, 1].astype(np.float64), sweep.xy[:, 0].astype(np.float64)))
        middle_s = 0.5 * (after_s[0] + after_s[-1])
        return middle_s + (bearing - 0.5 * (bearing[0] + bearing[-1])) * (self._turn_s / (2.0 * np.pi))

    def _span(self, row: int) -> tuple[float, float]:
        """Return the times of a sweep's first and last return after its stamp, s; zeros if all are simultaneous."""
        after_s = self._after_s(row)
        if not len(after_s) or after_s[0] == after_s[-1]:
            return 0.0, 0.0
        return float(after_s.min()), float(after_s.max())


def even_stamps(stamps_ns: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return stamps (n,) on lines fitted to the n increasing stamps as a function of the sweep's number.

    Each line is over as many sweeps on both sides, or to the next gap. That number is the one with which stamps are
    predicted best from the others (leave-one-out cross-validation): a longer line averages more delays, and a shorter
    one follows a laser whose rate drifts.
    """
    n = len(stamps_ns)
    if n < 2:
        return stamps_ns
    steps = np.diff(stamps_ns)
    period = float(np.median(steps))
    # gap in usual sweep periods, over which sweeps are not counted
    broken = np.flatnonzero(steps > 2.5 * period)
    first, last = np.append(0, broken + 1), np.append(broken, n - 1)
    stretch = np.searchsorted(last, np.arange(n))
    # deviations from one line keep the sums below small
    late = (stamps_ns - stamps_ns[0]).astype(np.float64) - period * np.arange(n)
    best, least = late, np.inf
    # smallest number of sweeps on each side over which the rate is taken as constant
    half = 10
    while True:
        smooth, share = _lines(late, first[stretch], last[stretch], half)
        miss = float(np.mean(np.abs(late - smooth) / np.maximum(1.0 - share, 1e-9)))
        if miss < least:
            best, least = smooth, miss
        if half > n:
            break
        half *= 2
    return stamps_ns + np.round(best - late).astype(np.int64)


def _lines(late: Array, first: NDArray[np.int64], last: NDArray[np.int64], half: int) -> tuple[Array, Array]:
    """Return the values (n,) of lines through windows at their sweeps, and the share of the sweep's own value in each.

    first, last : (n,) first and last sweep of the stretch without gaps that each sweep is in
    """
    rows = np.arange(len(late))
    begin, end = np.maximum(rows - half, first), np.minimum(rows + half, last) + 1

    def total(values: Array) -> Array:
        sums = np.concatenate(([0.0], np.cumsum(values)))
        return sums[end] - sums[begin]

    count = (end - begin).astype(np.float64)
    middle = 0.5 * (begin + end - 1)
    spread = np.maximum(count * (count**2 - 1.0) / 12.0, 0.5)
    mean = total(late) / count
    slope = (total(late * rows) - middle * total(late)) / spread
    aside = rows - middle
    return mean + slope * aside, 1.0 / count + aside**2 / spread


MOST_RETURNS = 720
"""Number of returns to which denser sweeps are thinned: more cost time and add little information."""


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
        # median deviation from even spacing below which stamps are kept, s: a robot moves a millimetre or two in that
        # time
        if not len(self) or np.median(np.abs(even - stamps)) < 2e-3 * 1e9 or np.any(np.diff(even) <= 0):
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


_FARTHEST_M = 200.0
_SLICE_RAD = np.radians(2.0)
_LEAST_SWEEPS = 20
_BODY_M, _BODY_SPREAD_M, _BODY_SHARE = 1.0, 0.01, 0.9


def only_scan_topic(reader: BagReader) -> str | None:
    """Return the only LaserScan topic of a bag, None if there is none or more than one."""
    topics = {c.topic for c in reader.channels.values() if c.msgtype == SCAN}
    return topics.pop() if len(topics) == 1 else None


def read_sweeps(path: Path, place: str, topic: str | None, base_frame: str) -> Sweeps:
    """Return all sweeps of a topic, without invalid ranges and returns from the robot itself.

    Parameters
    ----------
    path : a bag
    place : name of the bag for messages
    topic : LaserScan or PointCloud2; None takes the only LaserScan, or the only PointCloud2 if there is no LaserScan
    base_frame : the robot's frame, for the laser's mounting from TF

    Raises
    ------
    TopicError
        If there is no such topic, or the choice is ambiguous.
    RecordingError
        If there are too few sweeps or returns to match.
    """
    found = read_lasers(path, topic, (SCAN, CLOUD), place)
    name, rows = found.topic, list(zip(found.messages, found.log_ns.tolist(), strict=True))
    where = f"{place}: {name}"
    if len(rows) < _LEAST_SWEEPS:
        raise RecordingError(f"{where} holds {len(rows)} sweeps; scan matching needs many more than {_LEAST_SWEEPS}")
    rows, notes = _ordered(rows, name)
    frame = rows[0][0].frame_id
    mount = None
    with suppress(TopicError):
        mount = found.tree.mount(base_frame, frame, "")
    if mount is None:
        notes.append(f"{name}: TF does not contain the pose of {frame!r} on the robot; estimated from the motion")
    sweeps, view, more = _sweeps(rows, name)
    usual = float(np.median([len(s) for s in sweeps]))
    if usual < LEAST_RETURNS:
        raise RecordingError(
            f"{where}: {usual:.0f} returns in a typical sweep ({'; '.join(more) or 'the others have no return'}); scan "
            f"matching needs {LEAST_RETURNS} or more that are not the robot itself: name another topic with --scan"
        )
    logs = np.array([log for _, log in rows], dtype=np.int64)
    first = rows[0][0]
    by_scan_time = isinstance(first, ScanMessage) and not _has_increment(first) and _time_step_s(first) > 0.0
    return Sweeps(where, name, frame, sweeps, view, logs, mount, (*notes, *more), by_scan_time)


def _ordered(
    rows: list[tuple[ScanMessage | CloudMessage, int]], name: str
) -> tuple[list[tuple[ScanMessage | CloudMessage, int]], list[str]]:
    """Return the messages in order of their stamps, and notes on messages left out and on the stamps."""
    notes = []
    stamps = np.array([m.stamp_ns for m, _ in rows])
    logs = np.array([log for _, log in rows])
    if not stamps.any():
        stamps = logs
        notes.append(f"{name}: no stamps in the messages, log times used: they include delays of arrival")
    elif np.ptp(stamps - logs) < 1 and np.any(np.diff(np.sort(logs)) > 0) and len(np.unique(stamps % 1000)) > 500:
        notes.append(f"{name}: apparently stamped on arrival; delays of arrival count as noise")
    _, index = np.unique(stamps, return_index=True)
    if len(index) < len(rows):
        notes.append(f"{name}: {len(rows) - len(index)} sweeps with duplicate stamps left out")
    kept = [(replace(rows[i][0], stamp_ns=int(stamps[i])), rows[i][1]) for i in index]
    return kept, notes


def _sweeps(
    rows: list[tuple[ScanMessage | CloudMessage, int]], name: str
) -> tuple[tuple[Sweep, ...], float, list[str]]:
    first = rows[0][0]
    if not isinstance(first, ScanMessage):
        sweeps = tuple(_slice(message) for message, _ in rows)  # type: ignore[arg-type]
        return sweeps, _view_of(sweeps), [f"{name}: a horizontal slice of its points"]
    scans: list[ScanMessage] = [m for m, _ in rows]  # type: ignore[misc]
    notes = []
    farthest = _no_return_m(scans)
    body = _own_body(scans, farthest)
    if body is not None:
        notes.append(f"{name}: {np.count_nonzero(body)} of {len(body)} bearings see the robot itself: left out")
    view = abs(first.angle_step) * (len(first.ranges_m) - 1)
    return tuple(_returns(scan, farthest, body) for scan in scans), float(view), notes


def _no_return_m(scans: list[ScanMessage]) -> float:
    """Return the range above which there is no return, m: the stated maximum, or a largest range that is too common."""
    stated = scans[0].range_max_m
    largest = stated if np.isfinite(stated) and stated > scans[0].range_min_m else _FARTHEST_M
    sample = np.concatenate([s.ranges_m for s in scans[:: max(1, len(scans) // 200)]])
    sample = sample[np.isfinite(sample) & (sample > 0.0) & (sample < largest)]
    if len(sample):
        top = float(sample.max())
        if np.mean(sample > top - 1e-3) > 0.03:
            return top - 1e-3
    # fraction of the maximum range above which a range means no return: drivers write the maximum or just below it
    return min(0.995 * largest, _FARTHEST_M)


def _own_body(scans: list[ScanMessage], farthest: float) -> NDArray[np.bool_] | None:
    """Return a mask of bearings with a constant near range although the robot moved (its own body); None if none."""
    count = len(scans[0].ranges_m)
    chosen = [s.ranges_m for s in scans[:: max(1, len(scans) // 300)] if len(s.ranges_m) == count]
    table = np.stack(chosen)
    valid = np.isfinite(table) & (table > 0.0) & (table < farthest)
    filled = np.where(valid, table, np.nan)
    with np.errstate(all="ignore"):
        middle = np.nanmedian(np.where(valid.any(axis=0), filled, 0.0), axis=0)
        spread = np.nanmedian(np.where(valid.any(axis=0), np.abs(filled - middle), 1.0), axis=0)
    own = (middle < _BODY_M) & (spread < _BODY_SPREAD_M) & (valid.mean(axis=0) > _BODY_SHARE)
    others = valid.any(axis=0) & ~own
    # for a robot at rest, all ranges are constant
    moved = others.any() and float(np.nanmedian(spread[others])) > _BODY_SPREAD_M
    return own if own.any() and (moved or not others.any()) else None


def _returns(scan: ScanMessage, farthest: float, body: NDArray[np.bool_] | None) -> Sweep:
    ranges = scan.ranges_m
    with np.errstate(invalid="ignore"):
        good = (ranges > 0.0) & (ranges >= scan.range_min_m) & (ranges < farthest)
    if body is not None and len(body) == len(good):
        good &= ~body
    hit = np.flatnonzero(good)
    if len(hit) > MOST_RETURNS:
        hit = hit[np.linspace(0, len(hit) - 1, MOST_RETURNS).round().astype(np.int64)]
    angle = scan.angle_min + scan.angle_step * hit
    xy = ranges[hit, None] * np.stack((np.cos(angle), np.sin(angle)), axis=1)
    step = _time_step_s(scan)
    return Sweep(scan.stamp_ns, xy.astype(np.float32), (hit * step).astype(np.float32))


def _has_increment(scan: ScanMessage) -> bool:
    return scan.time_step_s != 0.0 and bool(np.isfinite(scan.time_step_s))


def _time_step_s(scan: ScanMessage) -> float:
    """Return the time between two bearings, s: the time_increment, or from scan_time, or 0 if unknown."""
    if _has_increment(scan):
        # some drivers write the duration of a sweep as time_increment
        return scan.time_step_s if abs(scan.time_step_s) * len(scan.ranges_m) < 1.0 else 0.0
    if 0.0 < scan.scan_time_s < 1.0:
        return scan.scan_time_s * abs(scan.angle_step) / (2.0 * np.pi)
    return 0.0


def _slice(cloud: CloudMessage) -> Sweep:
    """Return a sweep with the nearest point at each bearing in the horizontal plane of the laser."""
    xyz, after = cloud.xyz, cloud.after_s
    good = np.isfinite(xyz).all(axis=1)
    xyz, after = xyz[good], after[good]
    radius = np.hypot(xyz[:, 0], xyz[:, 1])
    planar = len(xyz) > 0 and np.ptp(xyz[:, 2]) < 0.01
    near = (radius > 0.05) & (radius < _FARTHEST_M)
    level = near & (planar | (np.abs(np.arctan2(xyz[:, 2], radius)) < _SLICE_RAD))
    xyz, after, radius = xyz[level], after[level], radius[level]
    cell = np.floor((np.arctan2(xyz[:, 1], xyz[:, 0]) + np.pi) * (MOST_RETURNS / (2.0 * np.pi))).astype(np.int64)
    order = np.lexsort((radius, cell))
    _, first = np.unique(cell[order], return_index=True)
    chosen = order[first]
    return Sweep(cloud.stamp_ns, xyz[chosen, :2].astype(np.float32), after[chosen].astype(np.float32))


def _view_of(sweeps: tuple[Sweep, ...]) -> float:
    """Return the field of view of sweeps, rad: a full turn minus the largest sector without any return."""
    some = sweeps[:: max(1, len(sweeps) // 50)]
    bearing = np.sort(np.concatenate([np.arctan2(s.xy[:, 1], s.xy[:, 0]) for s in some if len(s)] or [np.zeros(1)]))
    gaps = np.diff(np.concatenate((bearing, bearing[:1] + 2.0 * np.pi)))
    return float(2.0 * np.pi - gaps.max())

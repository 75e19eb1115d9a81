"""Laser scans as the truth: the trajectory of a run from its odometry and scans, by scan matching."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.open import open_reader
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import wrap
from odomcorrupt.geometry.trajectory import distance_along
from odomcorrupt.laser.calibrate import calibrate
from odomcorrupt.laser.closure import end_by_scans, lifted
from odomcorrupt.laser.moving import without_moving
from odomcorrupt.laser.scans import only_scan_topic, read_sweeps
from odomcorrupt.laser.slam import make_map
from odomcorrupt.laser.trajectory import (
    LaserRun,
    relocalised,
    white_noise,
    with_noise,
    with_view_errors,
    without_spikes,
)
from odomcorrupt.study.io.bag import read_bag
from odomcorrupt.study.io.first_look import mistakes_alone
from odomcorrupt.study.io.jumps import without_outliers
from odomcorrupt.study.io.raw_trajectory import FEWEST, Samples, in_order
from odomcorrupt.study.io.segments import MIN_PART_S
from odomcorrupt.study.io.topic_selection import has_truth

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.laser.scans import Motion, Sweeps
    from odomcorrupt.laser.trajectory import LaserPath

SCALE_ACCURACY = 0.003
"""Default standard deviation of a laser's scale error: 0.3 %."""
NO_SCAN = "none"
"""Value in place of a topic that switches the laser off."""
_WEAK_SAID = 0.1
_LAG_SAID_S = 0.02
_BLIND = 0.9
_JITTER_SAID_S = 3e-3
_COMPARED_M, _LEAST_TRAVEL = 0.5, 0.5
"""Travel over which laser and odometry are compared, m, and the least ratio: no odometry of wheels doubles travel."""
_BREAKS_SAID, _MOVED_M, _MOVED_DEG = 3, 0.05, 2.0
_GAP_SAID_S, _GAP_PERIODS = 2.0, 5.0


def only_scan(path: Path) -> str | None:
    """Return the only scan topic of a bag without a truth topic; None if it has a truth or not exactly one scan."""
    with open_reader(path) as reader:
        topic = only_scan_topic(reader)
        return None if topic is None or has_truth(reader.channels.values()) else topic


def laser_run(
    path: Path, place: str, odom: str | None, scan: str | None, progress: Callable[[str, float], None] | None = None
) -> LaserRun:
    """Return the trajectory of one run by the laser, from the odometry and scans of a bag.

    place : name of the bag in messages
    odom, scan : odometry topic or TF edge, and topic of the scans; default: the only ones
    progress : called with the stage and the fraction done

    Raises
    ------
    TopicError
        If a topic is missing, or the choice is ambiguous.
    RecordingError
        If the scans do not give a trajectory; the message has the reason.
    """
    odometry = read_bag(path, place, {"odometry": odom})["odometry"]
    return match_run(*beside_sweeps(odometry, path, place, scan), progress)


def end_seen(path: Path, place: str, odom: str | None, scan: str) -> Array:
    """Return the end pose (3,) of a drive relative to its start, m and rad, from its first and last scans.

    Parameters as for `laser_run`.

    Raises
    ------
    RecordingError
        If the last scans do not match the first.
    """
    odometry = read_bag(path, place, {"odometry": odom})["odometry"]
    odometry, sweeps = beside_sweeps(odometry, path, place, scan)
    return end_by_scans(sweeps, without_outliers(odometry).trajectory()).pose


def beside_sweeps(odometry: Samples, path: Path, place: str, scan: str | None) -> tuple[Samples, Sweeps]:
    """Return an odometry in the order of its stamps, and the sweeps of a bag, mounted on the odometry's child frame."""
    odometry = in_order(odometry)
    return odometry, read_sweeps(path, place, scan, odometry.child or "base_link")


def match_run(odometry: Samples, sweeps: Sweeps, progress: Callable[[str, float], None] | None = None) -> LaserRun:
    """Return the laser's trajectory of a run from its odometry and its sweeps; see `laser_run`."""
    if not odometry.headed:
        raise RecordingError(f"{odometry.place}: has positions without headings; odometry needs both")
    calm = without_outliers(odometry)
    for mistake in mistakes_alone(calm):
        raise RecordingError(mistake.sentence)
    guide = calm.trajectory()
    origin_ns = int(guide.stamps_ns[0])
    first = max(int(sweeps.stamps_ns[0]), int(odometry.stamps_ns[0]))
    last = min(int(sweeps.stamps_ns[-1]), int(odometry.stamps_ns[-1]))
    if last - first < 10_000_000_000:
        raise RecordingError(
            f"{sweeps.place} and {odometry.name} share {max(last - first, 0) * 1e-9:.1f} s: one of their clocks is "
            "simulated or unset; record both with one clock"
        )
    calibration = without_moving(calibrate(sweeps, guide, origin_ns))
    sweeps = calibration.sweeps
    tracked = make_map(sweeps, calibration, _part(progress, "matching scans", 0.0, 0.8))
    found = relocalised(calibration, tracked, _part(progress, "placing scans in the map", 0.8, 1.0))
    if len(found) < FEWEST:
        raise RecordingError(
            f"{sweeps.place}: {len(found)} of {len(sweeps)} sweeps fit a map of the others; name another topic with "
            "--scan"
        )
    _check_travel(found, calibration.motion, sweeps.place)
    found = with_view_errors(without_spikes(found, calibration.motion), calibration.motion)
    noise = white_noise(found, calibration.motion)
    found = with_noise(found, calibration.motion, noise)
    return LaserRun(odometry.trajectory(), sweeps, calibration, tracked, found, noise)


def truth_of(run: LaserRun) -> list[Samples]:
    """Return the laser's trajectory as a truth: one for each connected part of the map that lasts at least 15 s.

    Sweeps without a match are left out. Stamps are those of the scans, not corrected for their lag against the
    odometry: the fit estimates it.
    """
    sweeps, path = run.sweeps, run.path
    origin_ns = run.calibration.motion.origin_ns
    stamps = origin_ns + np.round(path.t_s * 1e9).astype(np.int64)
    notes = [*sweeps.notes, *run.calibration.said, *_said(run)]
    blind = float(path.weak.mean())
    if blind > _BLIND:
        raise RecordingError(
            f"{sweeps.place}: in {blind:.0%} of the sweeps walls on one axis alone are seen: a corridor hides travel "
            "(not testable: wheel_scale, speed_scale and all else that is travel); drive past corners"
        )
    found = []
    for part in np.unique(path.part):
        own = np.flatnonzero(path.part == part)
        if float(path.t_s[own[-1]] - path.t_s[own[0]]) < MIN_PART_S:
            continue
        logs, covariance = sweeps.log_ns[path.row[own]], path.covariance[own]
        one = Samples.planar(sweeps.place, sweeps.topic, stamps[own], path.xyt[own], log_ns=logs, covariance=covariance)
        found.append(one)
    if not found:
        raise RecordingError(
            f"{sweeps.place}: no part of the map lasts {MIN_PART_S:g} s ({'; '.join(notes)}); drive slower, or name "
            "another topic with --scan"
        )
    lost = int(np.count_nonzero(run.tracked.keyframe < 0))
    if lost:
        notes.append(f"{lost} of {len(sweeps)} sweeps fit nowhere and are left out")
    found[0] = found[0].noted(*(note.removeprefix(f"{sweeps.topic}: ") for note in notes))
    return found


def alerts_of(run: LaserRun) -> list[str]:
    """Return sentences on findings that change what the laser's trajectory is: wrong TF, and breaks of the map.

    The parts on both sides of a break are placed relative to each other by the sweeps next to it, which are matched
    from every heading within 0.6 m of where the odometry has them.
    """
    said, path, motion = [], run.path, run.calibration.motion
    if yaw := run.calibration.against_tf_rad:
        said.append(
            f"the laser is turned by {np.degrees(yaw):.0f} deg from its pose in TF; its mounting is estimated from "
            "the motion"
        )
    breaks = np.flatnonzero(np.diff(path.part))
    for k in breaks[:_BREAKS_SAID]:
        t_s = path.t_s[[k, k + 1]] + motion.lag_s
        lift = lifted(run, int(path.row[k]), int(path.row[k + 1]))
        what = "moved or lifted?"
        if lift is not None:
            length, turn = float(np.hypot(lift.moved[0], lift.moved[1])), abs(float(np.degrees(lift.moved[2])))
            across = "" if lift.whole else " across the walls (along them is not seen)"
            what = f"the robot was moved by {turn:.0f} deg and {length:.2f} m{across}, which is not in the odometry"
            if lift.whole:
                where = "along={:.3g},across={:.3g},yaw={:.3g}".format(*lift.moved.tolist())
                when = f"time={t_s[0]:.4g},duration={t_s[1] - t_s[0]:.2g}"
                what += f"; to corrupt with it: --effect push:{where},{when}"
            steps = np.diff(motion.robot(np.linspace(path.t_s[k], path.t_s[k + 1], 20)), axis=0)
            gone_m, turned_rad = np.hypot(steps[:, 0], steps[:, 1]).sum(), np.abs(wrap(steps[:, 2])).sum()
            # what an odometry with errors of 5 % may be off by
            if length < _MOVED_M + 0.05 * gone_m and turn < _MOVED_DEG + 0.05 * np.degrees(turned_rad):
                what = "the odometry agrees with the scans on both sides, so the robot was not moved"
        said.append(f"at {t_s[1]:.1f} s scans do not connect: {what}; each side is treated as a separate run")
    if len(breaks) > _BREAKS_SAID:
        said.append(f"scans do not connect at {len(breaks) - _BREAKS_SAID} more times")
    return said


def _said(run: LaserRun) -> list[str]:
    """Return messages about limitations of a laser's trajectory: lag, weak geometry, jitter, gaps and a low rate."""
    path, said = run.path, []
    lag = run.calibration.motion.lag_s
    if abs(lag) > _LAG_SAID_S:
        way = "late" if lag < 0.0 else "early"
        said.append(
            f"scans are stamped about {abs(lag):.2f} s {way} against odometry, which is equivalent to odometry that is "
            f"{'early' if way == 'late' else 'late'}"
        )
    weak = float(path.weak.mean())
    if weak > _WEAK_SAID:
        said.append(
            f"in {weak:.0%} of the sweeps walls on one axis alone are seen: motion along them is not known there; "
            "drive past corners"
        )
    if run.noise.stamps_s > _JITTER_SAID_S:
        said.append(
            f"stamps of the sweeps are off by about {1e3 * run.noise.stamps_s:.0f} ms each (stamped on arrival?): what "
            "that does in turns counts as noise of the laser"
        )
    stamps_s = run.sweeps.middle_s(run.calibration.motion.origin_ns)
    apart_s = np.diff(stamps_s)
    missing = np.flatnonzero(apart_s > max(_GAP_SAID_S, _GAP_PERIODS * run.sweeps.period_s))
    if len(missing):
        longest = missing[np.argmax(apart_s[missing])]
        more = f" ({len(missing)} gaps)" if len(missing) > 1 else ""
        said.append(f"no scans for {apart_s[longest]:.1f} s from {stamps_s[longest]:.1f} s on{more}")
    if run.sweeps.period_s > 0.5:
        said.append(f"one sweep in {run.sweeps.period_s:.1f} s: what changes faster is not seen")
    return said


def _check_travel(path: LaserPath, motion: Motion, place: str) -> None:
    """Refuse a laser that sees the robot travel far less than its odometry does.

    Distances between poses are compared, in which the mounting and the axes of the map do not matter.
    """
    own = motion.robot(path.t_s)[:, :2]
    gone = distance_along(own)
    ahead = np.searchsorted(gone, gone + _COMPARED_M)
    rows = np.flatnonzero(ahead < len(path))
    rows = rows[path.part[ahead[rows]] == path.part[rows]]
    travelled = np.linalg.norm(own[ahead[rows]] - own[rows], axis=1)
    rows, travelled = rows[travelled > 0.5 * _COMPARED_M], travelled[travelled > 0.5 * _COMPARED_M]
    if len(rows) < FEWEST:
        return
    seen = np.linalg.norm(path.xyt[ahead[rows], :2] - path.xyt[rows, :2], axis=1)
    ratio = float(np.median(seen / travelled))
    if ratio < _LEAST_TRAVEL:
        raise RecordingError(
            f"{place}: shows {ratio:.0%} of the odometry's travel: it sees mainly what moves with the robot, such as a "
            "person who follows or leads it; drive alone, with walls in reach"
        )


def _part(
    progress: Callable[[str, float], None] | None, what: str, first: float, last: float
) -> Callable[[float], None] | None:
    return None if progress is None else lambda share: progress(what, first + (last - first) * share)

"""Reading of a robot's runs: odometry and truth from any supported source, cleaned and checked, with notes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.open import open_reader
from odomcorrupt.drive_types import STEERED
from odomcorrupt.errors import RecordingError
from odomcorrupt.study.io.bag import read_bag
from odomcorrupt.study.io.feedback import feedback_of
from odomcorrupt.study.io.fixes import without_float_episodes
from odomcorrupt.study.io.gyro import gyro_truth, only_imu, read_gyro, yaw_gyro
from odomcorrupt.study.io.jumps import without_excursions, without_outliers
from odomcorrupt.study.io.laser_truth import NO_SCAN, alerts_of, laser_run, only_scan, truth_of
from odomcorrupt.study.io.localisation import MAP_SCALE_ACCURACY, corrections_alone, has_own_scale, is_of_base
from odomcorrupt.study.io.plausibility import check_pair
from odomcorrupt.study.io.raw_trajectory import in_order
from odomcorrupt.study.io.relative_motions import chains_of, read_motions
from odomcorrupt.study.io.segments import independent_parts, without_frozen, without_gaps
from odomcorrupt.study.io.self_consistency import check_itself
from odomcorrupt.study.io.stamps import between_steps, even_stamps, jitter_warnings, stamp_jitter_s, stamp_resolution_s
from odomcorrupt.study.io.text import is_text, read_text
from odomcorrupt.study.io.topic_selection import FLAGS, has_truth, parse_address
from odomcorrupt.study.io.warnings import (
    check_identity,
    dead_band_warnings,
    filter_warnings,
    heading_warnings,
    without_constant_heading,
    without_course,
)
from odomcorrupt.study.io.wheel_ticks import odometry_of_wheels, read_wheels, wheels_of
from odomcorrupt.study.io.yaw_dead_band import yaw_dead_band

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.study.io.raw_trajectory import Samples
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.io.source import Source
    from odomcorrupt.study.io.topic_selection import Address, Role

_OTHER_TRACK = 0.01
"""Relative difference from which a given track is reported as different from the odometry's."""


def read_runs(source: Source, progress: Callable[[str, float], None] | None = None) -> list[Recording]:
    """Return the recordings of one run, with the robot's drive type; several if resets split it.

    progress : called with the name of the stage and the fraction done

    Raises
    ------
    TopicError
        If a topic or frame is missing, or if several topics fit.
    RecordingError
        If the data cannot be odometry and truth of one run.
    """
    if source.drive_type in STEERED:
        source = replace(source, track_m=None)
    return [replace(run, drive_type=source.drive_type) for run in _read_runs(source, progress)]


def _read_runs(source: Source, progress: Callable[[str, float], None] | None) -> list[Recording]:
    """Return the recordings of one run without the drive type; see `read_runs`."""
    if source.relative is not None:
        return _by_motions(source, source.relative)
    scan = source.scan or automatic_scan(source)
    if scan is not None and scan != NO_SCAN:
        if source.truth is not None or source.truth_path is not None:
            raise RecordingError(f"{_place(source)}: --scan {scan} and a truth; name one of them")
        return _by_laser(source, scan, progress)
    imu = source.imu or automatic_imu(source)
    if imu is not None and not _has_truth(source):
        return _by_gyro(source, imu)
    odometry, truth = _read(source)
    wheels = _with_wheels(source, odometry)
    runs = _between_clock_steps(replace(source, track_m=wheels.track_m), wheels.odometry, truth)
    return _with_heading_source(source, imu, odometry, wheels.noted(runs))


def read_odometry(source: Source) -> tuple[Trajectory, float | None]:
    """Return the odometry of a run, and the track if it is given or follows from the wheel angles.

    Raises
    ------
    TopicError, RecordingError
        If there is no odometry, or if it is implausible.
    """
    place = _place(source)
    odom = parse_address(source.odom) if source.odom is not None else None
    odometry = in_order(_read_one(source.path, place, "odometry", odom))
    if not odometry.headed:
        raise RecordingError(f"{odometry.place}: has positions without headings; odometry needs both")
    check_itself(without_outliers(odometry))
    wheels = _with_wheels(source, odometry)
    return wheels.odometry.trajectory(), wheels.track_m


def _by_laser(source: Source, scan: str, progress: Callable[[str, float], None] | None) -> list[Recording]:
    """Return the recordings of a run with laser scans as truth."""
    odom = parse_address(source.odom) if source.odom is not None else None
    place = _place(source)
    wheels = _with_wheels(source, in_order(_read_one(source.path, place, "odometry", odom)))
    try:
        run = laser_run(source.path, place, odom, scan, progress, odometry=wheels.odometry)
        parts = truth_of(run)
    except RecordingError as why:
        if source.scan or not (source.imu or automatic_imu(source)):
            raise
        raise RecordingError(f"{why}; --scan {NO_SCAN} leaves the laser out: diagnose by the gyro alone") from None
    found: list[Recording] = []
    name = source.name or source.path.name
    for part in parts:
        try:
            found += recordings_of(name, wheels.odometry, part, wheels.track_m, source.truth_shift_s)
        except RecordingError:
            if len(parts) == 1:
                raise
    if not found:
        raise RecordingError(f"{_place(source)}: no part of the laser's map is long enough; drive slower or longer")
    chosen = "" if source.scan else f"no truth: the laser on {scan} is used instead (as with --scan {scan})"
    error = source.truth_scale_error
    said = f"the laser's scale is accurate to {error:.2%}, which limits all scales (--laser-scale-accuracy)"
    runs = [
        replace(
            r,
            name=f"{r.name}, map part {i + 1}" if len(parts) > 1 else r.name,
            frame=name,
            truth_scale_error=error,
            clock=r.clock or (f"{name} from {r.origin_ns}" if len(found) > 1 else ""),
            alerts=tuple(alerts_of(run)) if i == 0 else (),
            notes=(r.notes[0], *([chosen] if chosen and i == 0 else []), *r.notes[1:], *([said] if i == 0 else [])),
        )
        for i, r in enumerate(found)
    ]
    return _with_heading_source(source, source.imu or automatic_imu(source), wheels.odometry, wheels.noted(runs))


def _by_motions(source: Source, path: Path) -> list[Recording]:
    """Return the recordings of a run with a file of relative motions as truth, one for each chain of motions."""
    place = _place(source)
    if source.truth is not None or source.truth_path is not None or source.scan is not None:
        raise RecordingError(f"{place}: --relative {path} and a truth or scans; name one of them")
    odom = parse_address(source.odom) if source.odom is not None else None
    odometry = in_order(_read_one(source.path, place, "odometry", odom))
    wheels = _with_wheels(source, odometry)
    motions = read_motions(path)
    shift = round(source.truth_shift_s * 1e9)
    motions = motions._replace(start_ns=motions.start_ns + shift, end_ns=motions.end_ns + shift)
    found: list[Recording] = []
    chains = chains_of(motions, wheels.odometry)
    name = source.name or source.path.name
    for chain in chains:
        try:
            found += recordings_of(name, wheels.odometry, chain, wheels.track_m)
        except RecordingError:
            if len(chains) == 1:
                raise
    if not found:
        raise RecordingError(f"{place}: no chain of motions is long enough; record longer")
    error = source.truth_scale_error
    said = f"lengths of the motions are accurate to {error:.2%}, which limits all scales (--laser-scale-accuracy)"
    runs = [
        replace(
            r,
            name=f"{r.name}, chain {i + 1}" if len(found) > 1 else r.name,
            frame=f"{r.name}, chain {i + 1}" if len(found) > 1 else r.name,
            truth_scale_error=error,
            clock=r.clock or (f"{name} from {r.origin_ns}" if len(found) > 1 else ""),
            notes=(*r.notes, *([said] if i == 0 else [])),
        )
        for i, r in enumerate(found)
    ]
    return _with_heading_source(source, source.imu or automatic_imu(source), odometry, wheels.noted(runs))


def _by_gyro(source: Source, imu: str) -> list[Recording]:
    """Return the recordings of a run that has only odometry and a gyro: its truth has headings only."""
    place = _place(source)
    odom = parse_address(source.odom) if source.odom is not None else None
    odometry = in_order(_read_one(source.path, place, "odometry", odom))
    gyro = yaw_gyro(read_gyro(source.path, place, imu), odometry)
    wheels = _with_wheels(source, odometry)
    truth = gyro_truth(wheels.odometry, gyro)
    name = source.name or source.path.name
    runs = wheels.noted(recordings_of(name, wheels.odometry, truth, wheels.track_m, source.truth_shift_s))
    error = source.gyro_scale_error
    said = (
        (
            f"no truth, no laser: wheels and the gyro on {imu} alone. What they disagree about is an error of one of "
            "them; travel cannot be known (not testable: wheel_scale, speed_scale and all else that is travel)"
        ),
        f"the gyro's turns are accurate to {error:.2%}, which limits any gain of turns (--gyro-scale-accuracy)",
    )
    return [
        replace(
            r,
            positioned=False,
            pulled_per_s=0.0,
            turn_scale_error=error,
            heading_source=gyro.heading_source,
            notes=(*r.notes, *(said if i == 0 else ())),
        )
        for i, r in enumerate(runs)
    ]


def _with_heading_source(source: Source, imu: str | None, odometry: Samples, runs: list[Recording]) -> list[Recording]:
    """Return the recordings with the source of the odometry's heading, as found from a gyro beside the truth."""
    if imu is None:
        return runs
    try:
        gyro = yaw_gyro(read_gyro(source.path, _place(source), imu), in_order(odometry))
    except RecordingError as error:
        if source.imu is not None:
            raise
        return [replace(runs[0], notes=(*runs[0].notes, f"the gyro is left out: {error}")), *runs[1:]]
    return [
        replace(r, heading_source=gyro.heading_source, notes=(*r.notes, *(gyro.notes if i == 0 else ())))
        for i, r in enumerate(runs)
    ]


@dataclass(frozen=True, slots=True)
class _Wheeled:
    """Odometry to learn from, the robot's track, and findings from its wheel angles."""

    odometry: Samples
    track_m: float | None
    notes: tuple[str, ...] = ()

    def noted(self, runs: list[Recording]) -> list[Recording]:
        """Return the recordings with these findings among their notes."""
        return [replace(runs[0], notes=(*runs[0].notes, *self.notes)), *runs[1:]]


def _with_wheels(source: Source, odometry: Samples) -> _Wheeled:
    """Return the odometry with findings from the bag's wheel angles, or odometry made from them if joints are named."""
    plain = _Wheeled(odometry, source.track_m)
    if is_text(source.path):
        return plain
    angles = read_wheels(source.path, _place(source), source.joints)
    if angles is None:
        return plain
    try:
        wheels = wheels_of(angles, odometry)
    except RecordingError as error:
        if source.joints is not None:
            raise
        return replace(plain, notes=(f"the wheels' angles are left out: {error}",))
    track_m, notes = source.track_m, wheels.notes
    if track_m is None and wheels.heading:
        track_m = wheels.track_m
    elif track_m is not None and wheels.heading and abs(track_m / wheels.track_m - 1.0) > _OTHER_TRACK:
        notes = (*notes, f"--track {track_m:g} m is not the {wheels.track_m:.4g} m that the odometry is made with")
    if source.joints is not None:
        return _Wheeled(odometry_of_wheels(angles, wheels, odometry), track_m, notes)
    return _Wheeled(odometry, track_m, notes)


def _between_clock_steps(source: Source, odometry: Samples, truth: Samples) -> list[Recording]:
    """Return the recordings of a run, separated at steps of a clock."""
    name = source.name or source.path.name
    parts, others = between_steps(odometry), between_steps(truth)
    found: list[Recording] = []
    left: list[str] = []
    for one in parts:
        before = len(found)
        for other in others:
            part = f"{name} clock {len(found) + 1}" if len(parts) * len(others) > 1 else name
            try:
                found += recordings_of(part, one, other, source.track_m, source.truth_shift_s)
            except RecordingError as error:
                why = error
        if len(found) == before:
            left.append(f"{len(one)} poses between steps of its clock left out: {why}")
    if not found:
        raise why
    found[0] = replace(found[0], notes=(*found[0].notes, *left))
    said = f"the map's lengths are taken as accurate to {MAP_SCALE_ACCURACY:.2%}, which limits all scales"
    return [
        replace(r, truth_scale_error=MAP_SCALE_ACCURACY, notes=(*r.notes, said)) if r.localised else r for r in found
    ]


def recordings_of(
    name: str, odometry: Samples, truth: Samples, track_m: float | None = None, truth_shift_s: float = 0.0
) -> list[Recording]:
    """Return the recordings of odometry and truth, checked and cleaned; several if resets split them.

    track_m, truth_shift_s : track, None if unknown; seconds added to the stamps of the truth

    Raises
    ------
    RecordingError
        If they cannot be of one run; the message gives the reason.
    """
    odometry, truth = in_order(odometry), in_order(truth)
    rounded_s = math.hypot(stamp_resolution_s(odometry), stamp_resolution_s(truth))
    odometry, truth = even_stamps(odometry), even_stamps(truth)
    if truth_shift_s:
        shift = round(truth_shift_s * 1e9)
        truth = truth.stamped(truth.stamps_ns + shift).noted(f"stamps shifted by {truth_shift_s:g} s")
    if not odometry.headed:
        raise RecordingError(f"{odometry.place}: has positions without headings; odometry needs both")
    truth = without_float_episodes(without_course(odometry, without_constant_heading(odometry, truth)))
    if not truth.relative:
        truth = without_excursions(odometry, corrections_alone(odometry, truth))
    calm, real = without_outliers(odometry), without_outliers(truth)
    for path in (calm, real):
        check_itself(path)
    check_pair(calm, real)
    said = check_identity(calm, real) or heading_warnings(calm, real)
    feedback = feedback_of(odometry, calm, real)
    # The reader of laser scans has checked their stamps already.
    jitter_s = stamp_jitter_s(calm, real), stamp_jitter_s(real, calm) if truth.covariance is None else 0.0
    said += filter_warnings(calm, real, feedback)
    dead_band_radps = yaw_dead_band(calm, real)
    said += dead_band_warnings(calm, dead_band_radps)
    said += jitter_warnings(calm, jitter_s[0]) + jitter_warnings(real, jitter_s[1])
    odometry = feedback.free
    truth = without_gaps(odometry, without_frozen(odometry, truth))
    opening = f"odometry {_description(odometry)}, truth {_description(truth)}"
    recordings = independent_parts(name, odometry, truth, track_m)
    return [
        replace(
            r,
            notes=(opening, *r.notes, *said),
            stamp_error_s=rounded_s / math.sqrt(12.0),
            stamp_jitter_s=max(jitter_s),
            localised=truth.localised,
            own_scale=has_own_scale(truth),
            of_base=is_of_base(truth, odometry),
            pulled_per_s=feedback.left_per_s,
            pose_corrections=feedback.corrections,
            yaw_dead_band_radps=dead_band_radps,
            odometry_topic=odometry.name if odometry.name.startswith("/") else "",
        )
        for r in recordings
    ]


def automatic_scan(source: Source) -> str | None:
    """Return the only scan topic of a bag if neither a scan nor a truth is named; otherwise None."""
    if source.truth is not None or source.truth_path is not None or is_text(source.path):
        return None
    return only_scan(source.path)


def automatic_imu(source: Source) -> str | None:
    """Return the only Imu topic of a bag; None for text files, and if there is none or several."""
    return None if is_text(source.path) else only_imu(source.path)


def _has_truth(source: Source) -> bool:
    """Return whether a truth is named, or the bag holds a candidate for one."""
    if source.truth is not None or source.truth_path is not None or is_text(source.path):
        return True
    with open_reader(source.path) as reader:
        return has_truth(reader.channels.values())


def _place(source: Source) -> str:
    return source.name or str(source.path)


def _read(source: Source) -> tuple[Samples, Samples]:
    place = _place(source)
    odom = parse_address(source.odom) if source.odom is not None else None
    truth = parse_address(source.truth) if source.truth is not None else None
    if source.truth_path is None:
        if is_text(source.path):
            raise RecordingError(f"{place}: a text file holds one trajectory; name the truth's with --truth-bag")
        both = read_bag(source.path, place, {"odometry": odom, "truth": truth})
        return both["odometry"], both["truth"]
    odometry = _read_one(source.path, place, "odometry", odom)
    return odometry, _read_one(source.truth_path, str(source.truth_path), "truth", truth)


def _read_one(path: Path, place: str, role: Role, address: Address | None) -> Samples:
    if not is_text(path):
        return read_bag(path, place, {role: address})[role]
    if address is not None:
        raise RecordingError(f"{place}: is a text file, which has no topics; leave {FLAGS[role]} {address} out")
    return read_text(path, place)


def _description(path: Samples) -> str:
    frame = f" in frame {path.frame}" if path.frame else ""
    positions = "" if np.isfinite(path.yaw_rad).any() else " (positions without headings)"
    return f"{path.name}{frame}{positions}"

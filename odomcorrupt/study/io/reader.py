"""Reading of a robot's runs: odometry and truth from any supported source, cleaned and checked, with notes."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.open import open_reader
from odomcorrupt.drive_types import STEERED
from odomcorrupt.errors import RecordingError, TopicError
from odomcorrupt.geometry.trajectory import resolution_s
from odomcorrupt.study.io.bag import read_bag
from odomcorrupt.study.io.feedback import feedback_of
from odomcorrupt.study.io.first_look import first_look, mistakes_alone
from odomcorrupt.study.io.fixes import without_float_episodes
from odomcorrupt.study.io.gyro import gyro_truth, only_imu, read_gyro, yaw_gyro
from odomcorrupt.study.io.jumps import without_excursions, without_outliers
from odomcorrupt.study.io.laser_truth import NO_SCAN, alerts_of, beside_sweeps, match_run, only_scan, truth_of
from odomcorrupt.study.io.localisation import (
    MAP_SCALE_ACCURACY,
    corrections_alone,
    is_in_map,
    is_localised,
    is_of_base,
    spaced_by_motion,
)
from odomcorrupt.study.io.motion_windows import Look, Witness
from odomcorrupt.study.io.plausibility import check_together
from odomcorrupt.study.io.raw_trajectory import in_order
from odomcorrupt.study.io.recording import sketch_of
from odomcorrupt.study.io.relative_motions import chains_of, read_motions
from odomcorrupt.study.io.segments import independent_parts, without_frozen, without_gaps
from odomcorrupt.study.io.stamps import between_steps, even_stamps, jitter_warnings, stamp_jitter_s
from odomcorrupt.study.io.text import is_text, read_text
from odomcorrupt.study.io.topic_selection import FLAGS, has_truth
from odomcorrupt.study.io.warnings import check_identity, filter_warnings, without_course
from odomcorrupt.study.io.wheel_ticks import odometry_of_wheels, read_wheels, wheels_of

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from pathlib import Path

    from odomcorrupt.geometry.trajectory import Trajectory
    from odomcorrupt.study.io.raw_trajectory import Samples
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.io.source import Source
    from odomcorrupt.study.io.topic_selection import Role

_CONTINUED = 2.0
"""Usual intervals within which the next file of a split recording begins."""
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
    scan = source.scan or (None if source.names_truth or is_text(source.path) else only_scan(source.path))
    if source.relative is not None:
        found = _by_motions(source, source.relative)
    elif scan is not None and scan != NO_SCAN:
        found = _by_laser(source, scan, progress)
    elif not _has_truth(source) and (imu := _imu_of(source)) is not None:
        found = _by_gyro(source, imu)
    else:
        odometry, truth = _read(source)
        wheels = _with_wheels(source, odometry)
        found = _with_heading_source(source, wheels, _between_clock_steps(source, wheels, truth))
    return [replace(run, drive_type=source.drive_type) for run in found]


def read_study(sources: Sequence[Source], progress: Callable[[str, float], None] | None = None) -> list[Recording]:
    """Return the recordings of several runs of one robot; of several, unusable ones are left out with an alert.

    progress : as in `read_runs`

    Raises
    ------
    TopicError, RecordingError
        If none is usable; see `read_runs`.
    """
    found: list[Recording] = []
    refused: list[RecordingError | TopicError] = []
    for n, source in enumerate(sources):
        if progress is not None:
            progress("reading", n / len(sources))
        try:
            own = None if progress is None else lambda stage, share, n=n: progress(stage, (n + share) / len(sources))
            found += read_runs(source, own)
        except (RecordingError, TopicError) as why:
            refused.append(why)
    if not found:
        raise refused[0]
    return one_study(found, [f"left out: {why}" for why in refused])


def one_study(recordings: Sequence[Recording], alerts: Sequence[str] = ()) -> list[Recording]:
    """Return recordings with the clocks and places that they share; the first one with more alerts.

    A recording that begins where another one ends, as files split while recording do, has its clock. If each run has
    its truth begin at exactly zero, it has a frame of its own, and no place is common to them.
    """
    found = list(recordings)
    for i in sorted(range(len(found)), key=lambda i: int(found[i].odometry.stamps_ns[0])):
        before = next((r for r in found if r is not found[i] and _continues(r, found[i])), None)
        if before is not None and not found[i].clock:
            name = before.clock or f"{before.name} from {before.origin_ns}"
            at = next(j for j, r in enumerate(found) if r is before)
            found[at] = replace(before, clock=name)
            found[i] = replace(found[i], clock=name, origin_ns=before.origin_ns)
    if len(found) > 1 and all(not r.frame and not np.any(r.truth.xyt[0]) for r in found):
        found = [replace(r, frame=r.name) for r in found]
    found[0] = replace(found[0], alerts=(*found[0].alerts, *alerts))
    return found


def _continues(before: Recording, after: Recording) -> bool:
    """Return whether both trajectories of a recording go on in another one: at most two usual intervals later."""
    pairs = ((before.odometry, after.odometry), (before.truth, after.truth))
    return all(
        0 < int(b.stamps_ns[0]) - int(a.stamps_ns[-1]) <= _CONTINUED * float(np.median(np.diff(a.stamps_ns)))
        for a, b in pairs
    )


def read_odometry(source: Source) -> tuple[Trajectory, float | None]:
    """Return the odometry of a run, and the track if it is given or follows from the wheel angles.

    Raises
    ------
    TopicError, RecordingError
        If there is no odometry, or if it is implausible.
    """
    odometry = _odometry_of(source)
    if not odometry.headed:
        raise RecordingError(f"{odometry.place}: has positions without headings; odometry needs both")
    for mistake in mistakes_alone(in_order(odometry)):
        raise RecordingError(mistake.sentence)
    wheels = _with_wheels(source, odometry)
    return wheels.odometry.trajectory(), wheels.track_m


def _by_laser(source: Source, scan: str, progress: Callable[[str, float], None] | None) -> list[Recording]:
    """Return the recordings of a run with laser scans as truth."""
    if source.names_truth:
        raise RecordingError(f"{source.place}: --scan {scan} and a truth; name one of them")
    wheels = _with_wheels(source, _odometry_of(source))
    try:
        run = match_run(*beside_sweeps(wheels.odometry, source.path, source.place, scan), progress)
        parts = truth_of(run)
    except RecordingError as why:
        if source.scan or not _imu_of(source):
            raise
        raise RecordingError(f"{why}; --scan {NO_SCAN} leaves the laser out: diagnose by the gyro alone") from None
    error = source.truth_scale_error
    said = f"the laser's scale is accurate to {error:.2%}, which limits all scales (--laser-scale-accuracy)"
    too_short = "no part of the laser's map is long enough; drive slower or longer"
    runs = _of_parts(source, wheels, parts, too_short, "map part", said)
    runs = [replace(r, frame=source.title) for r in runs]
    (opening, *others), chosen = runs[0].notes, f"no truth: the laser on {scan} is used instead (as with --scan {scan})"
    notes = (opening, *(() if source.scan else (chosen,)), *others)
    runs[0] = replace(runs[0], alerts=(*runs[0].alerts, *alerts_of(run)), notes=notes)
    return runs


def _by_motions(source: Source, path: Path) -> list[Recording]:
    """Return the recordings of a run with a file of relative motions as truth, one for each chain of motions."""
    if source.names_truth or source.scan is not None:
        raise RecordingError(f"{source.place}: --relative {path} and a truth or scans; name one of them")
    wheels = _with_wheels(source, _odometry_of(source))
    chains = chains_of(read_motions(path, source.truth_shift_s), wheels.odometry)
    error, source = source.truth_scale_error, replace(source, truth_shift_s=0.0)
    said = f"lengths of the motions are accurate to {error:.2%}, which limits all scales (--laser-scale-accuracy)"
    too_short = "no chain of motions is long enough; record longer"
    return [replace(r, frame=r.name) for r in _of_parts(source, wheels, chains, too_short, "chain", said)]


def _of_parts(
    source: Source, wheels: _Wheeled, parts: list[Samples], too_short: str, part: str, said: str
) -> list[Recording]:
    """Return the recordings of the parts of a truth that are long enough, of lengths as accurate as the source's.

    part : what a part is called in names; said : a note on the truth
    """
    found: list[Recording] = []
    left_out: list[str] = []
    for one in parts:
        try:
            found += recordings_of(source.title, wheels.odometry, one, wheels.track_m, source.truth_shift_s)
        except RecordingError as error:
            if len(parts) == 1:
                raise
            left_out.append(str(error))
    if not found:
        raise RecordingError(f"{source.place}: {too_short}")
    runs = [replace(r, truth_scale_error=source.truth_scale_error) for r in found]
    if len(runs) > 1:
        runs = [replace(r, clock=r.clock or f"{source.title} from {r.origin_ns}") for r in runs]
    if len(parts) > 1:
        runs = [replace(r, name=f"{r.name}, {part} {i}") for i, r in enumerate(runs, start=1)]
    lost = [f"{len(left_out)} of {len(parts)} {part}s left out: {', '.join(sorted(set(left_out)))}"] if left_out else []
    return _with_heading_source(source, wheels, _noted(runs, said, *lost))


def _by_gyro(source: Source, imu: str) -> list[Recording]:
    """Return the recordings of a run that has only odometry and a gyro: its truth has headings only."""
    odometry = _odometry_of(source)
    gyro = yaw_gyro(read_gyro(source.path, source.place, imu), odometry)
    wheels = _with_wheels(source, odometry)
    truth = gyro_truth(wheels.odometry, gyro)
    runs = recordings_of(source.title, wheels.odometry, truth, wheels.track_m, source.truth_shift_s)
    error = source.gyro_scale_error
    runs = [
        replace(r, positioned=False, pulled_per_s=0.0, heading_source=gyro.heading_source, turn_scale_error=error)
        for r in runs
    ]
    return _noted(
        runs,
        *wheels.notes,
        f"no truth, no laser: wheels and the gyro on {imu} alone. What they disagree about is an error of one of "
        "them; travel cannot be known (not testable: wheel_scale, speed_scale and all else that is travel)",
        f"the gyro's turns are accurate to {error:.2%}, which limits any gain of turns (--gyro-scale-accuracy)",
    )


def _with_heading_source(source: Source, wheels: _Wheeled, runs: list[Recording]) -> list[Recording]:
    """Return the recordings with notes on the wheels, and the source of the heading by a gyro beside the truth."""
    runs, imu = _noted(runs, *wheels.notes), _imu_of(source)
    if imu is None:
        return runs
    try:
        gyro = yaw_gyro(read_gyro(source.path, source.place, imu), in_order(wheels.odometry))
    except RecordingError as error:
        if source.imu is not None:
            raise
        return _noted(runs, f"the gyro is left out: {error}")
    return _noted([replace(r, heading_source=gyro.heading_source) for r in runs], *gyro.notes)


def _noted(runs: list[Recording], *notes: str) -> list[Recording]:
    """Return the recordings of one run, the first one with more notes."""
    return [replace(runs[0], notes=(*runs[0].notes, *notes)), *runs[1:]]


@dataclass(frozen=True, slots=True)
class _Wheeled:
    """Odometry to learn from, the robot's track, and findings from its wheel angles."""

    odometry: Samples
    track_m: float | None
    notes: tuple[str, ...] = ()


def _with_wheels(source: Source, odometry: Samples) -> _Wheeled:
    """Return the odometry with findings from the bag's wheel angles, or odometry made from them if joints are named."""
    angles = None if is_text(source.path) else read_wheels(source.path, source.place, source.joints)
    if angles is None:
        return _Wheeled(odometry, source.track_m)
    try:
        wheels = wheels_of(angles, odometry)
    except RecordingError as error:
        if source.joints is not None:
            raise
        return _Wheeled(odometry, source.track_m, (f"the wheels' angles are left out: {error}",))
    track_m, notes = source.track_m, wheels.notes
    if track_m is None and wheels.heading:
        track_m = wheels.track_m
    elif track_m is not None and wheels.heading and abs(track_m / wheels.track_m - 1.0) > _OTHER_TRACK:
        notes = (*notes, f"--track {track_m:g} m is not the {wheels.track_m:.4g} m that the odometry is made with")
    if source.joints is not None:
        odometry = odometry_of_wheels(angles, wheels, odometry)
    return _Wheeled(odometry, track_m, notes)


def _between_clock_steps(source: Source, wheels: _Wheeled, truth: Samples) -> list[Recording]:
    """Return the recordings of a run, separated at steps of a clock."""
    parts, others = between_steps(wheels.odometry), between_steps(truth)
    found: list[Recording] = []
    left: list[str] = []
    for one in parts:
        before = len(found)
        for other in others:
            name = f"{source.title}, clock {len(found) + 1}" if len(parts) * len(others) > 1 else source.title
            try:
                shift_s, seen = source.truth_shift_s, lambda: _witnesses(source)
                found += recordings_of(name, one, other, wheels.track_m, shift_s, seen)
            except RecordingError as error:
                why = error
        if len(found) == before:
            left.append(f"{len(one)} poses between steps of its clock left out: {why}")
    if not found:
        raise why
    said = f"the map's lengths are taken as accurate to {MAP_SCALE_ACCURACY:.2%}, which limits all scales"
    return [
        replace(r, truth_scale_error=MAP_SCALE_ACCURACY, notes=(*r.notes, said)) if r.localised else r
        for r in _noted(found, *left)
    ]


def recordings_of(
    name: str,
    odometry: Samples,
    truth: Samples,
    track_m: float | None = None,
    truth_shift_s: float = 0.0,
    witnesses: Callable[[], Sequence[Witness]] = tuple,
) -> list[Recording]:
    """Return the recordings of odometry and truth, checked and cleaned; several if resets split them.

    track_m, truth_shift_s : track, None if unknown; seconds added to the stamps of the truth
    witnesses : other sources of turns, which decide which of the two turns the wrong way

    Raises
    ------
    RecordingError
        If they cannot be of one run; the message gives the reason.
    """
    odometry, truth = in_order(odometry), in_order(truth)
    recorded = odometry
    rounded_s = math.hypot(resolution_s(odometry.stamps_ns), resolution_s(truth.stamps_ns))
    odometry, truth = even_stamps(odometry), even_stamps(truth)
    if truth_shift_s:
        shift = round(truth_shift_s * 1e9)
        truth = truth.stamped(truth.stamps_ns + shift).noted(f"stamps shifted by {truth_shift_s:g} s")
    if not odometry.headed:
        raise RecordingError(f"{odometry.place}: has positions without headings; odometry needs both")
    found = first_look(Look((odometry, without_float_episodes(truth)), witnesses, track_m))
    odometry, truth = found.odometry, found.truth
    mended_ns = (odometry if len(odometry) == len(recorded) else recorded).stamps_ns
    truth = without_float_episodes(without_course(odometry, truth))
    if not truth.relative:
        truth = without_excursions(odometry, corrections_alone(odometry, truth))
    calm, real = without_outliers(odometry), without_outliers(truth)
    check_together(calm, real)
    said = check_identity(calm, real)
    said += [mistake.sentence for mistake in found.mistakes]
    feedback = feedback_of(odometry, calm, real)
    # The reader of laser scans has checked their stamps already.
    jitter_s = stamp_jitter_s(calm, real), stamp_jitter_s(real, calm) if truth.covariance is None else 0.0
    said += filter_warnings(calm, feedback)
    said += jitter_warnings(calm, jitter_s[0]) + jitter_warnings(real, jitter_s[1])
    odometry = feedback.free
    truth = without_gaps(odometry, without_frozen(odometry, truth))
    opening = f"odometry {_description(odometry)}, truth {_description(truth)}"
    recordings = independent_parts(name, odometry, truth, track_m)
    return [
        spaced_by_motion(
            replace(
                r.multiplied(*(1.0 / gain for gain in found.gains)),
                notes=(opening, *r.notes, *said),
                mistakes=found.mistakes,
                gains=found.gains,
                ratios=found.ratios,
                stamp_error_s=rounded_s / math.sqrt(12.0),
                stamp_jitter_s=max(jitter_s),
                localised=is_localised(truth),
                in_map=is_in_map(truth),
                of_base=is_of_base(truth, odometry),
                pulled_per_s=feedback.left_per_s,
                pose_corrections=feedback.corrections,
                yaw_dead_band_radps=found.dead_band_radps,
                odometry_topic=odometry.name if odometry.name.startswith("/") else "",
                sketch=sketch_of(
                    recorded.only(
                        np.arange(*np.searchsorted(mended_ns, r.odometry.stamps_ns[[0, -1]] + [0, 1]))
                    ).trajectory()
                ),
            )
        )
        for r in recordings
    ]


def _witnesses(source: Source) -> list[Witness]:
    """Return the turns of a bag's gyro about z, and of its wheels."""
    found = []
    if (imu := _imu_of(source)) is not None:
        gyro = read_gyro(source.path, source.place, imu)
        seconds = np.diff(gyro.stamps_ns, prepend=gyro.stamps_ns[0]) * 1e-9
        found.append(Witness(imu, gyro.stamps_ns, np.cumsum(gyro.rates[:, 2] * seconds), independent=True))
    angles = None if is_text(source.path) else read_wheels(source.path, source.place, source.joints)
    if angles is not None:
        left, right = angles.angle.T
        found.append(Witness(" and ".join(angles.joints), angles.stamps_ns, right - left, independent=False))
    return found


def _imu_of(source: Source) -> str | None:
    """Return the Imu topic that is named, or the only one of a bag; None if there is none or several."""
    return source.imu or (None if is_text(source.path) else only_imu(source.path))


def _has_truth(source: Source) -> bool:
    """Return whether a truth is named, or the bag holds a candidate for one."""
    if source.names_truth or is_text(source.path):
        return True
    with open_reader(source.path) as reader:
        return has_truth(reader.channels.values())


def _read(source: Source) -> tuple[Samples, Samples]:
    if source.truth_path is not None:
        odometry = _read_one(source.path, source.place, "odometry", source.odom)
        return odometry, _read_one(source.truth_path, str(source.truth_path), "truth", source.truth)
    if is_text(source.path):
        raise RecordingError(f"{source.place}: a text file holds one trajectory; name the truth's with --truth-bag")
    both = read_bag(source.path, source.place, {"odometry": source.odom, "truth": source.truth})
    return both["odometry"], both["truth"]


def _odometry_of(source: Source) -> Samples:
    return in_order(_read_one(source.path, source.place, "odometry", source.odom))


def _read_one(path: Path, place: str, role: Role, name: str | None) -> Samples:
    if not is_text(path):
        return read_bag(path, place, {role: name})[role]
    if name is not None:
        raise RecordingError(f"{place}: is a text file, which has no topics; leave {FLAGS[role]} {name} out")
    return read_text(path, place)


def _description(path: Samples) -> str:
    frame = f" in frame {path.frame}" if path.frame else ""
    positions = "" if np.isfinite(path.yaw_rad).any() else " (positions without headings)"
    return f"{path.name}{frame}{positions}"

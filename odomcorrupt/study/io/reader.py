"""Read runs of a robot: odometry and truth from wherever they were recorded, cleaned, checked, and said so."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.drive_types import AUTO, STEERED
from odomcorrupt.errors import RecordingError
from odomcorrupt.study.io.address import parse_address
from odomcorrupt.study.io.bag import read_bag
from odomcorrupt.study.io.feedback import pull_of
from odomcorrupt.study.io.jitter import jitter_signs
from odomcorrupt.study.io.jumps import without_outliers
from odomcorrupt.study.io.laser_truth import SCALE_ACCURACY, laser_run, only_scan, truth_of
from odomcorrupt.study.io.localisation import corrections_alone
from odomcorrupt.study.io.plausibility import check_pair
from odomcorrupt.study.io.segments import independent_parts, without_frozen, without_gaps
from odomcorrupt.study.io.self_consistency import check_itself
from odomcorrupt.study.io.stamps import between_steps, even_stamps, stamp_resolution_s
from odomcorrupt.study.io.text import is_text, read_text
from odomcorrupt.study.io.time_order import in_order
from odomcorrupt.study.io.topic_selection import FLAGS
from odomcorrupt.study.io.warnings import check_identity, filter_signs, heading_signs, without_constant_heading

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from odomcorrupt.study.io.address import Address
    from odomcorrupt.study.io.raw_trajectory import Samples
    from odomcorrupt.study.io.recording import Recording
    from odomcorrupt.study.io.topic_selection import Role

__all__ = ["Source", "read_runs", "recordings_of"]


@dataclass(frozen=True, slots=True)
class Source:
    """Where one run lies.

    path : a bag, or a TUM or CSV file with the odometry
    odom, truth : topics, or edges of TF as /tf:map.base_link; None takes the only topic that can be meant
    truth_path : the bag, TUM or CSV file with the truth, where it is another one
    truth_shift_s : what is added to the stamps of the truth, seconds
    track_m : nominal distance between the wheels, where it is known
    name : what to call the run, where not by its path
    drive_type : how the robot's wheels steer it, see `drive_types`; one that is steered has no track
    scan : topic of a laser that is to be the truth; None takes the only one of a bag that holds no truth
    truth_scale_error : standard deviation of the laser's own scale error
    """

    path: Path
    odom: str | None = None
    truth: str | None = None
    truth_path: Path | None = None
    truth_shift_s: float = 0.0
    track_m: float | None = None
    name: str = ""
    scan: str | None = None
    truth_scale_error: float = SCALE_ACCURACY
    drive_type: str = AUTO


def read_runs(source: Source, progress: Callable[[str, float], None] | None = None) -> list[Recording]:
    """Read one run, as `_read_runs`, of a robot of this drive type."""
    if source.drive_type in STEERED:
        source = replace(source, track_m=None)
    return [replace(run, drive_type=source.drive_type) for run in _read_runs(source, progress)]


def _read_runs(source: Source, progress: Callable[[str, float], None] | None) -> list[Recording]:
    """Read one run: one recording, or several where resets cut it into independent stretches.

    progress : called with the stage and its share that is done

    Raises
    ------
    TopicError
        Where a topic or frame is missing or several could be meant; the message lists them.
    RecordingError
        Where what is there cannot be odometry and truth of one run; the message says why.

    """
    scan = source.scan or automatic_scan(source)
    if scan is None:
        return _between_clock_steps(source, *_read(source))
    if source.truth is not None or source.truth_path is not None:
        raise RecordingError(f"{_place(source)}: --scan {scan} and a truth; name one of them")
    odom = parse_address(source.odom) if source.odom is not None else None
    run = laser_run(source.path, _place(source), odom, scan, progress)
    found: list[Recording] = []
    name = source.name or source.path.name
    parts = truth_of(run)
    for part in parts:
        try:
            found += recordings_of(name, run.odometry, part, source.track_m, source.truth_shift_s)
        except RecordingError:
            if len(parts) == 1:
                raise
    if not found:
        raise RecordingError(f"{_place(source)}: no part of the laser's map carries a study; drive slower or longer")
    chosen = "" if source.scan else f"no truth: the laser on {scan} is learned from; --scan says so without this line"
    error = source.truth_scale_error
    said = f"the laser is a ruler good to {error:.2%}: no scale is known better (--laser-scale-accuracy)"
    return [
        replace(
            r,
            name=f"{r.name}, map part {i + 1}" if len(parts) > 1 else r.name,
            truth_scale_error=error,
            clock=r.clock or (f"{name} from {r.origin_ns}" if len(found) > 1 else ""),
            notes=(r.notes[0], *([chosen] if chosen and i == 0 else []), *r.notes[1:], *([said] if i == 0 else [])),
        )
        for i, r in enumerate(found)
    ]


def _between_clock_steps(source: Source, odometry: Samples, truth: Samples) -> list[Recording]:
    """Return the recordings of a run, those before and after a step of a clock apart."""
    name = source.name or source.path.name
    pairs = [(one, other) for one in between_steps(odometry) for other in between_steps(truth)]
    found: list[Recording] = []
    why: RecordingError | None = None
    for one, other in pairs:
        part = f"{name} clock {len(found) + 1}" if len(pairs) > 1 else name
        try:
            found += recordings_of(part, one, other, source.track_m, source.truth_shift_s)
        except RecordingError as error:
            why = error
    if why is not None and not found:
        raise why
    return found


def recordings_of(
    name: str, odometry: Samples, truth: Samples, track_m: float | None = None, truth_shift_s: float = 0.0
) -> list[Recording]:
    """Return the recordings of odometry and truth, checked and cleaned: several where resets cut them.

    Raises
    ------
    RecordingError
        Where they cannot be of one run; the message says why.

    """
    odometry, truth = in_order(odometry), in_order(truth)
    rounded_s = math.hypot(stamp_resolution_s(odometry), stamp_resolution_s(truth))
    odometry, truth = even_stamps(odometry), even_stamps(truth)
    if truth_shift_s:
        shift = round(truth_shift_s * 1e9)
        truth = truth.stamped(truth.stamps_ns + shift).noted(f"stamps shifted by {truth_shift_s:g} s")
    if not odometry.headed:
        raise RecordingError(f"{odometry.place}: has positions without headings; odometry needs both")
    truth = corrections_alone(odometry, without_constant_heading(odometry, truth))
    calm, real = without_outliers(odometry), without_outliers(truth)
    for path in (calm, real):
        check_itself(path)
    check_pair(calm, real)
    said = check_identity(calm, real) or heading_signs(calm, real)
    # a laser's reader has looked at its stamps already
    said += filter_signs(calm, real) + jitter_signs(calm) + (jitter_signs(real) if truth.covariance is None else [])
    truth = without_gaps(odometry, without_frozen(odometry, truth))
    opening = f"odometry {_named(odometry)}, truth {_named(truth)}"
    recordings = independent_parts(name, odometry, truth, track_m)
    return [
        replace(
            r,
            notes=(opening, *r.notes, *said),
            stamp_error_s=rounded_s / math.sqrt(12.0),
            localised=truth.localised,
            pulled_per_s=max(pull_of(calm, real)),
        )
        for r in recordings
    ]


def automatic_scan(source: Source) -> str | None:
    """Return the laser to learn from where neither it nor a truth is named, None where there is no need of one."""
    if source.truth is not None or source.truth_path is not None or is_text(source.path):
        return None
    return only_scan(source.path)


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
    odometry = _one(source.path, place, "odometry", odom)
    return odometry, _one(source.truth_path, str(source.truth_path), "truth", truth)


def _one(path: Path, place: str, role: Role, address: Address | None) -> Samples:
    if not is_text(path):
        return read_bag(path, place, {role: address})[role]
    if address is not None:
        raise RecordingError(f"{place}: is a text file, which has no topics; leave {FLAGS[role]} {address} out")
    return read_text(path, place)


def _named(path: Samples) -> str:
    frame = f" in frame {path.frame}" if path.frame else ""
    positions = "" if np.isfinite(path.yaw_rad).any() else " (positions without headings)"
    return f"{path.name}{frame}{positions}"

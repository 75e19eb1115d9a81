"""Detection of a truth that is a localisation on top of the odometry, and its reduction to the corrections.

AMCL and SLAM correct the odometry intermittently (nav2's amcl: after 0.25 m or 0.2 rad). Poses sampled from TF at a
fixed rate repeat the odometry with its errors in between, so only those at which the correction changed are used. Of
poses that a localisation sends at a high rate, those after some motion are: errors depend on the view, and are the same
in poses of one place.
"""

from __future__ import annotations

import math
import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.odometry_source import plain
from odomcorrupt.geometry.se2 import between, wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples
    from odomcorrupt.study.io.recording import Recording

REPEATED, CORRECTIONS = 0.3, 20
"""Least fraction of messages during motion that repeat the odometry's step in a localisation.

The second is the least number of corrections from which to learn.
"""
MAP_SCALE_ACCURACY = 0.001
"""Standard deviation of a map's relative scale error: one cell of 5 cm in 50 m (judgement; no published figure)."""
_MEASURED = re.compile(
    r"mocap|vicon|optitrack|qualisys|motive|tracker|reflector|total_station|ground|truth|global|(^|[/_])gt|rtk|gps|gnss|sim|gazebo"
)
"""Names of odometry topics whose positions are measured in a frame of known scale, or exact."""
_NAMES = re.compile(r"amcl|slam|locali[sz]|cartographer|rtabmap|hector")
"""Names of topics on which localisations publish their poses."""
_IMAGES = re.compile(r"orb|visual|vslam|vio|rtabmap|camera|stereo|rgbd|zed")
"""Names of topics of visual SLAM. Its poses at a high rate are of a tracker of images, which are good at all times."""
SPARSE_HZ = 5.0
"""Rate below which such poses are corrections; faster ones are sent at all times, also at rest."""
_APART_M, _APART_RAD = 0.25, 0.2
"""Motion after which the pose of a faster localisation is used: that after which nav2's amcl corrects."""
_STRAIGHT_RAD, _COARSE_M, _CORRELATED = 0.1, 0.005, 0.7
"""Largest turn of a straight step; spread of the error of 0.25 m of travel above which poses in the map are a
localisation's, if that of single steps is less than such a part of it. Simulated localisations have 9 to 15 mm, motion
capture with odometry of wheels 1 to 3 mm."""
_UNEVEN = 0.3
"""Spread (10 to 90 %) of the times between corrections over their median; updates by travel or turn exceed it."""
_BASES = frozenset({"base_link", "base_footprint"})
"""REP 105 and 120: a point of the robot, and its projection to the floor."""
_SAME, MOVES = 1e-6, 1e-4
"""Metres and radians: the difference of equal steps, and the motion of a robot at rest, are smaller."""
_MIN_CORRECTION = 5e-4
"""Least median correction, metres or radians; smaller ones are a simulator's rounding or the odometry itself."""
_MIN_MOTION = 0.05
"""Least odometry motion between corrections that are triggered by motion, metres or radians."""
_MAX_AGE = 4
"""Poses may use an odometry sample up to this many samples old, but have the stamp of the request."""


def corrections_alone(odometry: Samples, truth: Samples) -> Samples:
    """Return the truth reduced to its corrections if it repeats the odometry in between; otherwise unchanged.

    Both must be sorted by stamp. A truth of low rate that is named like a localisation's, and one in the frame of a map
    with the accuracy of a localisation, are marked as localised.
    """
    if not (truth.headed and odometry.headed):
        return truth
    if _is_coarse_in_map(odometry, truth):
        truth = replace(truth, localised=True)
    if len(truth) < SPARSE_HZ * truth.span_s:
        named = bool(_NAMES.search(truth.name.lower())) or _is_by_motion(odometry, truth)
        truth = replace(truth, localised=truth.localised or named)
    inside = np.flatnonzero(truth.within(odometry))
    if len(inside) < CORRECTIONS:
        return truth
    real = np.column_stack((truth.xyz[:, :2], truth.yaw_rad))[inside]
    best: NDArray[np.bool_] | None = None
    for path in _odometry_at(odometry, truth.stamps_ns[inside]):
        step, own = between(real[:-1], real[1:]), between(path[:-1], path[1:])
        apart = step - own
        apart[:, 2] = wrap(apart[:, 2])
        size = np.abs(apart).max(axis=1)
        repeats = size < _SAME
        moving = (np.abs(own) > MOVES).any(axis=1)
        new = ~repeats & moving
        if np.sum(repeats & moving) < REPEATED * np.sum(moving) or np.sum(new) < CORRECTIONS:
            continue
        if np.median(size[new]) < _MIN_CORRECTION:
            continue
        if best is None or np.sum(new) < np.sum(best):
            best = new
    if best is None:
        return truth
    rows = np.concatenate((inside[:1], inside[1:][best]))
    return replace(truth, localised=True).only(
        rows,
        f"a localisation on top of {odometry.name}; the truth is taken at its {len(rows)} corrections alone: between "
        "them it repeats the odometry",
    )


def is_localised(truth: Samples) -> bool:
    """Return whether a localisation in a map made the truth, at any rate: it was found to be one, or is named so."""
    name = truth.name.lower()
    named = _NAMES.search(name) and not (_MEASURED.search(name) or _IMAGES.search(name))
    return truth.localised or (bool(named) and truth.headed and not has_own_scale(truth))


def spaced_by_motion(recording: Recording) -> Recording:
    """Return a recording in which a localisation of high rate has only a pose after each 0.25 m or 0.2 rad of odometry.

    Poses of one place share most of their error. A stop would count as many poses that agree, and the rest of the
    errors, summed over the poses of a second, as decimetres of path.
    """
    truth, t_s = recording.truth, recording.truth_s
    inside = np.flatnonzero(recording.within_odometry)
    if not recording.localised or len(inside) < SPARSE_HZ * float(np.ptp(t_s[inside])):
        return recording
    rows = _after_motion(recording.odometry.at(t_s[inside], recording.origin_ns))
    if len(rows) < CORRECTIONS:
        return recording
    said = (
        f"the truth's poses after each {_APART_M:g} m or {_APART_RAD:g} rad are used, {len(rows)} of {len(truth)}: "
        "those in between share their errors"
    )
    kept = inside[rows]
    return replace(recording, truth=truth.only(kept), notes=(*recording.notes, said))


def _after_motion(path: Array) -> list[int]:
    """Return the indices of the poses of a path (n, 3) after each 0.25 m or 0.2 rad."""
    rows = [0]
    for i, pose in enumerate(path):
        x, y, turned = pose - path[rows[-1]]
        if math.hypot(x, y) >= _APART_M or abs(turned) >= _APART_RAD:
            rows.append(i)
    return rows


def has_own_scale(truth: Samples) -> bool:
    """Return whether the truth is an estimator's odometry whose name gives no source of its scale (visual SLAM)."""
    return truth.estimated and truth.geodetic_origin is None and not _MEASURED.search(truth.name.lower())


def is_in_map(truth: Samples) -> bool:
    """Return whether SLAM or a localisation made the truth, by its name or because its frame is called map (REP 105).

    Its errors are corrected in steps, however fast its poses are.
    """
    named = bool(_NAMES.search(truth.name.lower())) or plain(truth.frame).rpartition("/")[2] == "map"
    return named and not _MEASURED.search(truth.name.lower())


def is_of_base(truth: Samples, odometry: Samples) -> bool:
    """Return whether a localisation reports the odometry's own frame, without lever arm or mounting yaw.

    Messages without a child frame (nav2's /amcl_pose, slam_toolbox's /pose) refer to the base frame by definition;
    their remaining offset is the localisation's bias.
    """
    if not (is_localised(truth) and truth.frame):
        return False
    child, own = (plain(path.child).rpartition("/")[2] for path in (truth, odometry))
    return child in ("", own) or {child, own} <= _BASES


def _is_by_motion(odometry: Samples, truth: Samples) -> bool:
    """Return whether poses in the map follow certain amounts of motion (slam_toolbox's /pose), not a fixed rate."""
    if plain(truth.frame).rpartition("/")[2] != "map" or truth.child or len(truth) < CORRECTIONS:
        return False
    low, usual, high = np.quantile(np.diff(truth.stamps_ns), (0.1, 0.5, 0.9))
    own = _odometry_at(odometry, truth.stamps_ns)[0]
    moved = np.abs(between(own[:-1], own[1:])).max(axis=1) > _MIN_MOTION
    return bool(high - low > _UNEVEN * usual and moved.mean() > 1.0 - REPEATED)


def _is_coarse_in_map(odometry: Samples, truth: Samples) -> bool:
    """Return whether poses in the map have the errors of a localisation, whatever their topic is called.

    Their travel is compared with the odometry's over a quarter of a metre of straight driving. A constant error of the
    odometry does not count, nor does a marker's distance from the axis, nor white noise as of an antenna: errors of a
    localisation hardly change from one pose to the next.
    """
    name = truth.name.lower()
    if plain(truth.frame).rpartition("/")[2] != "map" or _MEASURED.search(name) or _IMAGES.search(name):
        return False
    inside = truth.within(odometry)
    if has_own_scale(truth) or not inside.any():
        return False
    own = _odometry_at(odometry, truth.stamps_ns[inside])[0]
    real = np.column_stack((truth.xyz[:, :2], truth.yaw_rad))[inside]
    every, apart = np.arange(len(own)), np.array(_after_motion(own))
    near_m, far_m = (_travel_error(own[rows], real[rows]) for rows in (every, apart))
    return far_m > _COARSE_M and near_m < _CORRELATED * far_m


def _travel_error(own: Array, real: Array) -> float:
    """Return the spread of real minus own travel on straight steps between poses (n, 3), m; 0 if there are too few."""
    steps = between(own[:-1], own[1:])
    straight = np.abs(steps[:, 2]) < _STRAIGHT_RAD
    apart = (between(real[:-1], real[1:]) - steps)[straight, 0]
    return 1.4826 * float(np.median(np.abs(apart - np.median(apart)))) if len(apart) >= CORRECTIONS else 0.0


def ahead_s(
    stamps_ns: NDArray[np.int64], logs_ns: NDArray[np.int64], other: tuple[NDArray[np.int64], NDArray[np.int64]]
) -> float:
    """Return by how much stamps are ahead of another publisher's stamps at the same log time, seconds.

    The stamps of both must count from one clock, which may be a simulator's; log times match the messages.

    stamps_ns, logs_ns : (n,) stamps and log times
    other : stamps and log times (m,) of the other publisher
    """
    order = np.argsort(other[1], kind="stable")
    others, logs = other[0][order], other[1][order]
    together = (logs_ns >= logs[0]) & (logs_ns <= logs[-1])
    if not together.any() or logs[0] == logs[-1]:
        return 0.0
    start = int(others[0])
    beside = np.interp((logs_ns[together] - logs[0]) * 1e-9, (logs - logs[0]) * 1e-9, (others - start) * 1e-9)
    return float(np.median((stamps_ns[together] - start) * 1e-9 - beside))


def _odometry_at(odometry: Samples, at_ns: NDArray[np.int64]) -> list[Array]:
    """Return candidates of the odometry (n, 3) at stamps: interpolated as in TF, and each of the latest samples."""
    own = np.column_stack((odometry.xyz[:, :2], np.unwrap(odometry.yaw_rad)))
    t_s, at_s = ((s - odometry.stamps_ns[0]).astype(np.float64) * 1e-9 for s in (odometry.stamps_ns, at_ns))
    last = np.searchsorted(odometry.stamps_ns, at_ns, side="right") - 1
    straight = np.stack([np.interp(at_s, t_s, column) for column in own.T], axis=1)
    return [straight, *(own[np.maximum(last - back, 0)] for back in range(_MAX_AGE))]

"""A localisation on top of the odometry: poses that repeat its steps between corrections.

AMCL and SLAM correct the odometry now and then (nav2's amcl: after 0.25 m or 0.2 rad). Asked for a pose in between, TF
answers with the last correction and the odometry since: whoever publishes poses from TF at a rate of his own publishes
the odometry, errors and all, and agrees with it. Only the poses at which the correction changed say where the robot is.
"""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.geometry.se2 import between, wrap
from odomcorrupt.study.io.address import plain

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

__all__ = ["CORRECTIONS", "REPEATED", "SPARSE_HZ", "ahead_s", "corrections_alone", "is_of_base"]

REPEATED, CORRECTIONS = 0.3, 20
"""A localisation repeats itself in at least this part of its messages while the robot moves.

It takes so many corrections to learn from.
"""
_NAMES = re.compile(r"amcl|slam|locali[sz]|cartographer|rtabmap|hector")
"""Topics on which a localisation publishes its own poses."""
SPARSE_HZ = 5.0
"""Rate below which such poses are corrections; above it a tracker of scans or images says where it is all the time."""
_UNEVEN = 0.3
"""Spread of times between corrections (10 to 90 %) over their median: updates every 0.5 m or 0.5 rad are uneven."""
_BASES = frozenset({"base_link", "base_footprint"})
"""REP 105 and 120: one point of the robot, and what lies below it on the floor."""
_SAME, _MOVES = 1e-6, 1e-4
"""Metres and radians: steps that differ by less are the same, and a robot that moves by less stands."""
_CORRECTS = 5e-4
"""Metres or radians of a usual correction at least: less is a simulator's rounding, or the odometry itself."""
_LEAST_MOTION = 0.05
"""Metres or radians of odometry between corrections that come after motion, at least."""
_BACK = 4
"""Poses may be asked for up to so many samples of the odometry late, and be stamped with the time of asking."""


def corrections_alone(odometry: Samples, truth: Samples) -> Samples:
    """Return the truth at its corrections where in between it repeats the odometry, as it is where it does not.

    Both by growing stamps. A sparse one that is by its name a localisation's is marked as such.
    """
    if not (truth.headed and odometry.headed):
        return truth
    if len(truth) < SPARSE_HZ * truth.span_s:
        named = bool(_NAMES.search(truth.name.lower())) or _is_by_motion(odometry, truth)
        truth = replace(truth, localised=truth.localised or named)
    inside = np.flatnonzero((truth.stamps_ns >= odometry.stamps_ns[0]) & (truth.stamps_ns <= odometry.stamps_ns[-1]))
    if len(inside) < CORRECTIONS:
        return truth
    real = np.column_stack((truth.xyz[:, :2], truth.yaw_rad))[inside]
    best: NDArray[np.bool_] | None = None
    for path in _readings(odometry, truth.stamps_ns[inside]):
        step, own = between(real[:-1], real[1:]), between(path[:-1], path[1:])
        apart = step - own
        apart[:, 2] = wrap(apart[:, 2])
        size = np.abs(apart).max(axis=1)
        repeats = size < _SAME
        moving = (np.abs(own) > _MOVES).any(axis=1)
        new = ~repeats & moving
        if np.sum(repeats & moving) < REPEATED * np.sum(moving) or np.sum(new) < CORRECTIONS:
            continue
        if np.median(size[new]) < _CORRECTS:
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


def is_of_base(truth: Samples, odometry: Samples) -> bool:
    """Tell whether a localisation gives poses of the odometry's own frame: it has neither lever arm nor mounting yaw.

    Messages without a child frame (nav2's /amcl_pose, slam_toolbox's /pose) are of the base frame by definition; what
    is wrong with them is the localisation's bias.
    """
    if not (truth.localised and truth.frame):
        return False
    child, own = (plain(path.child).rpartition("/")[2] for path in (truth, odometry))
    return child in ("", own) or {child, own} <= _BASES


def _is_by_motion(odometry: Samples, truth: Samples) -> bool:
    """Tell whether poses in the map come after so much motion, as slam_toolbox's /pose, and not at a rate of time."""
    if plain(truth.frame).rpartition("/")[2] != "map" or truth.child or len(truth) < CORRECTIONS:
        return False
    low, usual, high = np.quantile(np.diff(truth.stamps_ns), (0.1, 0.5, 0.9))
    own = _readings(odometry, truth.stamps_ns)[0]
    moved = np.abs(between(own[:-1], own[1:])).max(axis=1) > _LEAST_MOTION
    return bool(high - low > _UNEVEN * usual and moved.mean() > 1.0 - REPEATED)


def ahead_s(
    stamps_ns: NDArray[np.int64], logs_ns: NDArray[np.int64], other: tuple[NDArray[np.int64], NDArray[np.int64]]
) -> float:
    """Return by how much messages are stamped ahead of those of another publisher that are sent with them, seconds.

    Stamps of both count from one clock, which may be a simulator's; log times say what was sent together.

    other : its stamps and its log times (m,)
    """
    order = np.argsort(other[1], kind="stable")
    others, logs = other[0][order], other[1][order]
    together = (logs_ns >= logs[0]) & (logs_ns <= logs[-1])
    if not together.any() or logs[0] == logs[-1]:
        return 0.0
    start = int(others[0])
    beside = np.interp((logs_ns[together] - logs[0]) * 1e-9, (logs - logs[0]) * 1e-9, (others - start) * 1e-9)
    return float(np.median((stamps_ns[together] - start) * 1e-9 - beside))


def _readings(odometry: Samples, at_ns: NDArray[np.int64]) -> list[Array]:
    """Return what the odometry said (n, 3) at stamps: between its samples as TF has it, and at each of the last few."""
    own = np.column_stack((odometry.xyz[:, :2], np.unwrap(odometry.yaw_rad)))
    t_s, at_s = ((s - odometry.stamps_ns[0]).astype(np.float64) * 1e-9 for s in (odometry.stamps_ns, at_ns))
    last = np.searchsorted(odometry.stamps_ns, at_ns, side="right") - 1
    straight = np.stack([np.interp(at_s, t_s, column) for column in own.T], axis=1)
    return [straight, *(own[np.maximum(last - back, 0)] for back in range(_BACK))]

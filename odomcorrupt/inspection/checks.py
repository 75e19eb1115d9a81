"""Checks of an odometry topic: motion of the robot, and faults of stamps, numbers and covariances."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.path import JUMP_MIN_S, JUMP_SPEED
from odomcorrupt.corruption.pose_faults import FAR_M
from odomcorrupt.corruption.reorder import WINDOW_NS
from odomcorrupt.geometry.se2 import increments, interpolate, inverse, wrap

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.inspection.scan import EdgeRecord, OdometryRecord

MOVING = 0.05
"""Speed, m/s or rad/s, below which a robot counts as standing."""


@dataclass(frozen=True, slots=True)
class Findings:
    """Motion of the robot of one odometry topic, and warnings.

    distance, reverse, sideways : metres; turned : radians; duration, standing : seconds
    restarts : number of stamps that jump back by more than a second; swapped : by less than a second
    oddities : warnings, one sentence each
    """

    messages: int
    duration_s: float
    rate_hz: float | None
    distance_m: float
    reverse_m: float
    sideways_m: float
    turned_rad: float
    standing_s: float
    restarts: int
    swapped: int
    jumps: int
    oddities: tuple[str, ...]


def findings(record: OdometryRecord) -> Findings:
    """Return the motion and the warnings of one odometry topic."""
    finite = np.isfinite(record.xyt).all(axis=1)
    near = (np.abs(np.nan_to_num(record.xyt[:, :2])) < FAR_M).all(axis=1)
    leaps = _leaps(record.stamps_ns)
    sound = finite & near & ~leaps
    stamps, xyt = record.stamps_ns[sound], record.xyt[sound]
    back = _steps_back(stamps)
    dt = np.diff(stamps) * 1e-9
    steps = increments(xyt) if len(xyt) else increments(np.zeros((1, 3)))
    length = np.hypot(steps.ds_m, steps.dl_m)
    jump = length > JUMP_SPEED * np.maximum(dt, JUMP_MIN_S)
    good = (dt > 0.0) & ~jump
    speed = np.divide(length, dt, out=np.zeros_like(length), where=good)
    turning = np.divide(np.abs(steps.dtheta_rad), dt, out=np.zeros_like(length), where=good)
    duration = float(dt[dt > 0.0].sum())
    odd = []
    if record.zero_stamps:
        odd.append(f"{record.zero_stamps} of {len(record.stamps_ns)} stamps are zero: log times are used instead")
    if (numberless := np.count_nonzero(~finite) - record.faults.no_orientation) > 0:
        odd.append(f"{numberless} poses are not numbers")
    odd += record.faults.sentences()
    if leaps.any():
        odd.append(f"{np.count_nonzero(leaps)} stamps lie far ahead of their neighbours'")
    if record.twist is not None and not record.faults.paths.alternates:
        odd += _twist_oddities(record.twist[sound], xyt, dt, good, speed)
    for name, watch in (("pose", record.pose_covariance), ("twist", record.twist_covariance)):
        said = watch.oddity(never_changes=name == "pose")
        odd += [f"{name} covariances of x, y, yaw {said}"] if said else []
    return Findings(
        messages=len(record.stamps_ns),
        duration_s=duration,
        rate_hz=(len(stamps) - 1) / duration if duration > 0.0 and len(stamps) > 1 else None,
        distance_m=float(length[~jump].sum()),
        reverse_m=float(np.abs(steps.ds_m[~jump & (steps.ds_m < 0.0)]).sum()),
        sideways_m=float(np.abs(steps.dl_m[~jump]).sum()),
        turned_rad=float(np.abs(steps.dtheta_rad[~jump]).sum()),
        standing_s=float(dt[good & (speed < MOVING) & (turning < MOVING)].sum()),
        restarts=back.restarts,
        swapped=back.swapped,
        jumps=int(np.count_nonzero(jump & (dt >= -WINDOW_NS * 1e-9))),
        oddities=tuple(odd),
    )


@dataclass(frozen=True, slots=True)
class _StepsBack:
    restarts: int
    swapped: int


def _leaps(stamps_ns: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Return a mask (n,) of stamps far ahead of both neighbours: errors of one message, not restarts of time."""
    leaps = np.zeros(len(stamps_ns), dtype=bool)
    before, here, after = stamps_ns[:-2], stamps_ns[1:-1], stamps_ns[2:]
    leaps[1:-1] = (here > before + WINDOW_NS) & (here > after + WINDOW_NS) & (after >= before - WINDOW_NS)
    return leaps


def _steps_back(stamps_ns: NDArray[np.int64]) -> _StepsBack:
    """Count restarts (jumps back by more than the sorting window) and messages out of order by less."""
    restarts = swapped = 0
    while len(stamps_ns):
        behind = stamps_ns[1:] - np.maximum.accumulate(stamps_ns)[:-1]
        far = np.flatnonzero(behind < -WINDOW_NS)
        stop = int(far[0]) if len(far) else len(behind)
        swapped += int(np.count_nonzero(behind[:stop] < 0))
        restarts += bool(len(far))
        stamps_ns = stamps_ns[stop + 1 :]
    return _StepsBack(restarts, swapped)


def _twist_oddities(twist: Array, xyt: Array, dt: Array, good: NDArray[np.bool_], speed: Array) -> list[str]:
    """Return warnings where twists (n, 3) disagree with the rates of the poses, in the body or the odom frame."""
    finite = np.asarray(np.isfinite(twist).all(axis=1), dtype=np.bool_)
    odd = [] if finite.all() else [f"{np.count_nonzero(~finite)} twists are not numbers"]
    moving = good & (speed > MOVING) & finite[1:]
    if np.count_nonzero(moving) < 10:
        return odd
    steps = increments(xyt)
    # a corrupt number must not overflow when squared
    stated = np.clip(twist[1:][moving], -1e9, 1e9)
    body = np.column_stack((steps.ds_m, steps.dl_m))[moving] / dt[moving, None]
    world = np.diff(xyt[:, :2], axis=0)[moving] / dt[moving, None]
    if not stated.any():
        return [*odd, "twists are all zero while the robot moves"]
    in_body = float(np.sqrt(np.mean((stated[:, :2] - body) ** 2)))
    in_world = float(np.sqrt(np.mean((stated[:, :2] - world) ** 2)))
    typical = float(np.sqrt(np.mean(body**2)))
    if in_world < 0.5 * in_body and in_body > 0.1 * typical:
        odd.append("twists seem to be in the odom frame, not in the child frame as the message type requires")
    elif min(in_body, in_world) > 0.5 * typical:
        odd.append(f"twists do not fit the poses (they differ by {in_body:.2g} m/s at {typical:.2g} m/s)")
    return odd


def disagreement_m(record: OdometryRecord, edge: EdgeRecord, *, turned: bool) -> float | None:
    """Return the largest difference between a TF edge and the odometry, metres; None without overlap in time.

    turned : whether the edge points from the base to odom
    """
    order = np.argsort(record.stamps_ns, kind="stable")
    stamps, xyt = record.stamps_ns[order], record.xyt[order]
    inside = (edge.stamps_ns >= stamps[0]) & (edge.stamps_ns <= stamps[-1])
    if len(stamps) < 2 or not inside.any():
        return None
    at = edge.stamps_ns[inside]
    i = np.clip(np.searchsorted(stamps, at, side="right") - 1, 0, len(stamps) - 2)
    span = np.maximum(stamps[i + 1] - stamps[i], 1)
    odometry = interpolate(xyt[i], xyt[i + 1], np.clip((at - stamps[i]) / span, 0.0, 1.0))
    tf = inverse(edge.xyt[inside]) if turned else edge.xyt[inside]
    # a heading error counts as its displacement at a distance of 1 m
    off = np.hypot(*(tf - odometry)[:, :2].T) + np.abs(wrap((tf - odometry)[:, 2]))
    return float(np.nanmax(off)) if np.isfinite(off).any() else None

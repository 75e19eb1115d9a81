"""Wheel angles from JointState, and the nominal wheel radius and track with which the odometry integrates them.

Increments of pure wheel odometry are linear in the wheel angles: travel = (r/2)(right + left), turn = (r/b)(right -
left). Regression gives the driver's r and b; its residual shows whether the heading comes from the wheels.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.bags.messages import gather, gather_stamps_ns, located
from odomcorrupt.bags.open import open_reader
from odomcorrupt.errors import RecordingError, TopicError
from odomcorrupt.geometry.motion import step_of
from odomcorrupt.geometry.se2 import Increments, accumulate, increments
from odomcorrupt.study.io.raw_trajectory import FEWEST, REPORTED_LAG_S, Samples
from odomcorrupt.study.io.topic_selection import near

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

JOINTS = "sensor_msgs/msg/JointState"
_SPACING_S = 0.2
_LAGS_S = np.arange(-0.2, 0.2001, 0.02)
_MAX_RESIDUAL = 0.03  # largest relative residual of the regression
_RADII_M, _TRACKS_M = (5e-3, 2.0), (0.02, 10.0)  # plausible ranges


@dataclass(frozen=True, slots=True)
class WheelAngles:
    """Recorded angles of the left and right wheel: increasing stamps (n,), and angles (n, 2), rad."""

    place: str
    joints: tuple[str, str]
    stamps_ns: NDArray[np.int64]
    angle: Array


@dataclass(frozen=True, slots=True)
class Wheels:
    """Nominal wheel geometry of the odometry.

    radius_m, track_m : values used by the driver
    heading : whether the turns agree with the wheels', to within 3 %
    notes : findings, for reports
    """

    radius_m: float
    track_m: float
    heading: bool
    notes: tuple[str, ...]


def find_joints(names: Iterable[str]) -> tuple[str, str] | None:
    """Return the joints named as left and right wheel; None unless there is exactly one of each."""
    wheels = [name for name in names if re.search(r"wheel|drive", name, re.IGNORECASE)]
    sides = [[n for n in wheels if re.search(rf"(^|[^a-z]){s}($|[^a-z])|{w}", n, re.IGNORECASE)]
             for s, w in (("l", "left"), ("r", "right"))]  # fmt: skip
    return (sides[0][0], sides[1][0]) if len(sides[0]) == len(sides[1]) == 1 and sides[0] != sides[1] else None


def read_wheels(path: Path, place: str, joints: tuple[str, str] | None) -> WheelAngles | None:
    """Return the angles of two wheels; None if no joints are named and none are wheels by name.

    Raises
    ------
    TopicError
        If the named joints do not exist.
    RecordingError
        If the named joints have too few angles.
    """
    parts: list[tuple[NDArray[np.int64], Array]] = []
    seen: set[str] = set()
    with open_reader(path) as reader:
        channels = [c for c in reader.channels.values() if c.msgtype == JOINTS]
        if not channels and joints is None:
            return None
        for block, _, layout in located(reader, channels):
            item = layout.items[0]
            seen |= set(item.fields)
            both = joints or find_joints(item.fields)
            if both is not None and all(joint in item.fields for joint in both):
                chosen = both
                angle = np.column_stack([gather(block, layout, item, joint)[:, 0] for joint in both])
                parts.append((gather_stamps_ns(block, layout, item), angle))
    if not parts:
        if joints is None:
            return None
        raise TopicError(f"{place}: no JointState with {' and '.join(joints)} ({near(joints[0], seen)}); see --joints")
    stamps, angle = (np.concatenate(part) for part in zip(*parts, strict=True))
    good = np.isfinite(angle).all(axis=1)
    _, index = np.unique(stamps[good], return_index=True)
    stamps, angle = stamps[good][index], angle[good][index]
    if len(stamps) < FEWEST:
        if joints is None:
            return None
        raise RecordingError(
            f"{place}: {len(stamps)} angles of {' and '.join(joints)}; record more, or leave --joints out"
        )
    if np.ptp(angle) <= 2.0 * np.pi + 0.1:  # the driver wraps them every turn
        angle = np.unwrap(angle, axis=0)
    return WheelAngles(place, chosen, stamps, angle)


def wheels_of(angles: WheelAngles, odometry: Samples) -> Wheels:
    """Return the nominal radius and track with which the odometry integrates its wheel angles.

    Raises
    ------
    RecordingError
        If the odometry's travel does not match these wheels.
    """
    origin = int(odometry.stamps_ns[0])
    own_s, odo_s = (angles.stamps_ns - origin) * 1e-9, odometry.seconds_since(origin)
    first, last = max(own_s[0], odo_s[0]) + 0.3, min(own_s[-1], odo_s[-1]) - 0.3
    if last - first < 5.0:
        raise RecordingError(f"{angles.place}: wheels and {odometry.name} share no time; leave --joints out")
    path = odometry.trajectory()
    tried = []
    grid = np.arange(first, last, max(_SPACING_S, 4.0 * float(np.median(np.diff(own_s)))))
    for lag in _LAGS_S:
        steps = increments(path.at(grid, origin))
        turn = np.stack([np.diff(np.interp(grid - lag, own_s, angles.angle[:, i])) for i in (0, 1)], axis=1)
        sums = np.stack((turn.sum(axis=1), turn[:, 1] - turn[:, 0]), axis=1)
        goal = np.stack((steps.ds_m, steps.dtheta_rad), axis=1)
        slope = np.sum(sums * goal, axis=0) / np.maximum(np.sum(sums**2, axis=0), 1e-12)
        miss = np.sqrt(np.mean((goal - slope * sums) ** 2, axis=0)) / np.maximum(np.std(goal, axis=0), 1e-9)
        tried.append((float(miss[0]), float(lag), slope, miss))
    _, lag_s, slope, miss = min(tried, key=lambda one: one[0])
    names = " and ".join(angles.joints)
    radius = 2.0 * float(slope[0])
    track = radius / float(slope[1]) if abs(slope[1]) > 1e-6 else float("inf")
    if miss[0] > _MAX_RESIDUAL or not _RADII_M[0] < radius < _RADII_M[1]:
        raise RecordingError(
            f"{angles.place}: {odometry.name} does not travel as {names} turn ({miss[0]:.0%} off, radius {radius:.3f} "
            "m); name its wheels with --joints LEFT RIGHT, or leave it out"
        )
    heading = bool(miss[1] < _MAX_RESIDUAL and _TRACKS_M[0] < track < _TRACKS_M[1])
    notes = [f"{names}: wheels of {radius:.3g} m by the odometry's own sums"]
    if heading:
        notes[0] += f", {track:.3g} m apart: its nominal radius and track"
    else:
        notes.append(
            f"the odometry does not turn as {names} do ({miss[1]:.0%} off): its heading is not the wheels' alone"
        )
    if (tick := step_of(np.diff(angles.angle, axis=0).ravel())) is not None:
        notes.append(
            f"{names}: angles come in counts of {tick:.4g} rad ({2 * np.pi / tick:.0f} a turn, "
            f"{1e3 * tick * radius:.2g} mm)"
        )
    if abs(lag_s) > REPORTED_LAG_S:
        notes.append(
            f"odometry is stamped {abs(lag_s):.2f} s {'after' if lag_s > 0.0 else 'before'} the wheels' angles"
        )
    return Wheels(radius, track, heading, tuple(notes))


def odometry_of_wheels(angles: WheelAngles, wheels: Wheels, odometry: Samples) -> Samples:
    """Return the odometry integrated from the wheel angles, at their stamps, in the frame of the recorded odometry.

    Raises
    ------
    RecordingError
        If the recorded odometry's turns come from another source, so that the results would not apply to it.
    """
    if not wheels.heading:
        raise RecordingError(
            f"{angles.place}: the odometry's turns are not those of {' and '.join(angles.joints)}: what is learned of "
            "their sums would not be true of it; leave --joints out"
        )
    inside = (angles.stamps_ns >= odometry.stamps_ns[0]) & (angles.stamps_ns <= odometry.stamps_ns[-1])
    stamps, turn = angles.stamps_ns[inside], np.diff(angles.angle[inside], axis=0)
    ds, dtheta = 0.5 * wheels.radius_m * turn.sum(axis=1), wheels.radius_m / wheels.track_m * (turn[:, 1] - turn[:, 0])
    origin = int(odometry.stamps_ns[0])
    begin = odometry.trajectory().at((stamps[:1] - origin) * 1e-9, origin)
    return Samples.planar(
        f"{angles.place}: {' and '.join(angles.joints)}",
        f"{odometry.name} from its wheels' angles",
        stamps,
        accumulate(begin[0], Increments(ds, np.zeros_like(ds), dtheta)),
        frame=odometry.frame,
        notes=odometry.notes,
        child=odometry.child,
    )

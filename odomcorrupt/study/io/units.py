"""Units of lengths and headings of odometry and truth.

All checks compare motions over intervals, so that neither frames nor tracked points matter.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.corruption.pose_faults import PER_METRE
from odomcorrupt.errors import RecordingError
from odomcorrupt.geometry.se2 import wrap

if TYPE_CHECKING:
    from odomcorrupt.geometry.se2 import Array
    from odomcorrupt.study.io.raw_trajectory import Samples

GIVE_METRES = (
    "Give metres: mend the publisher and record again, or write the poses to a CSV file, whose columns x_mm, y_mm (or "
    "x_ft, y_ft, ...) name the unit"
)
"""What to do about lengths in another unit."""

_OF_A_UNIT = 1.1  # factor from a unit within which a ratio of travels is that unit
_MAX_RATIO = 20.0  # ratio of travels that no robot has
_USUAL = 1.3  # ratio of travels up to which wheels may be wrong
_WINDOWS_S = (2.0, 5.0, 10.0)
_USUALLY = 90.0  # percentile of distances: robots that stand most of the time move in this one
_LEAST_M = 0.1

_PER_DEGREE = 180.0 / np.pi
_DEGREES = (
    "its headings are degrees, not radians; in a CSV file, name the column yaw_deg; for a bag, convert them before "
    "making quaternions, and record again"
)
_SO_FAR = "they turn 57 times as far as"
_TURN_RAD, _LARGE_RAD = 0.03, 0.12  # least and largest turns compared: 57 times the least is about a quarter turn
_MIN_TURNS = 30
_STEP_S, _LEAST_STEP_M = 0.04, 0.002  # steps whose directions are compared with headings
_FITS, _MISFITS = 0.5, 0.5  # mean cosines of the differences of turns


def check_lengths(odometry: Samples, truth: Samples) -> list[str]:
    """Refuse lengths in different units; return a warning if the travels differ more than those of wrong wheels.

    Raises
    ------
    RecordingError
        If the ratio of travels is that of a unit to the metre, or beyond 20.
    """
    ratio = _ratio_of_travel(odometry, truth)
    if not ratio:
        return []
    small, large = (odometry, truth) if ratio > 1.0 else (truth, odometry)
    factor = max(ratio, 1.0 / ratio)
    unit = next((name for name, per_m in PER_METRE.items() if 1.0 / _OF_A_UNIT < factor / per_m < _OF_A_UNIT), None)
    if unit is not None or factor > _MAX_RATIO:
        raise RecordingError(
            f"{large.place}: covers {factor:.3g} times as much ground as {small.place}: {unit or 'another unit'} for "
            f"metres? {GIVE_METRES}"
        )
    if factor < _USUAL:
        return []
    said = (
        f"{large.name} travels {factor:.3g} times as far as {small.name}: check units, gear ratio and wheel radius of "
        "both before using this result"
    )
    return [said]


def _ratio_of_travel(odometry: Samples, truth: Samples) -> float:
    """Return the truth's usual distance within some seconds over the odometry's; 0 if the robot hardly moves.

    Noise lengthens short distances, and errors of heading shorten long ones: the most ordinary ratio counts. Lags do
    not matter.
    """
    origin = int(odometry.stamps_ns[0])
    first_s, last_s = (float(p.seconds_since(origin)[i]) for p, i in ((truth, 0), (truth, -1)))
    ratios = []
    for window_s in _WINDOWS_S:
        starts = np.arange(max(first_s, 0.0), min(last_s, odometry.span_s) - window_s, window_s / 4.0)
        if len(starts) < 4:
            continue
        here, there = (_usual_distance(p, p.seconds_since(origin), starts, window_s) for p in (odometry, truth))
        if max(here, there) > _LEAST_M and min(here, there) > 0.0:
            ratios.append(there / here)
    return min(ratios, key=lambda ratio: abs(np.log(ratio)), default=0.0)


def _usual_distance(path: Samples, t_s: Array, starts: Array, window_s: float) -> float:
    ends = [np.interp(at, t_s, path.xyz[:, i]) for at in (starts, starts + window_s) for i in (0, 1)]
    return float(np.percentile(np.hypot(ends[2] - ends[0], ends[3] - ends[1]), _USUALLY))


def check_degrees(odometry: Samples, truth: Samples) -> None:
    """Refuse headings that turn 57 times as far as those of the other path, or as the odometry's path does.

    A quaternion made of degrees hides them, because its headings are wrapped: differences are compared on the circle.

    Raises
    ------
    RecordingError
        If the headings of one path are in degrees.
    """
    _check_own_degrees(odometry)
    if not truth.headed:
        return
    at = truth.seconds_since(int(odometry.stamps_ns[0]))
    inside = (at >= 0.0) & (at <= odometry.span_s)
    heading = np.interp(at[inside], odometry.t_s, np.unwrap(odometry.yaw_rad))
    picked = _turning_points(heading)
    if _in_degrees(np.diff(truth.yaw_rad[inside][picked]), np.diff(heading[picked])):
        raise RecordingError(f"{truth.place}: {_DEGREES} ({_SO_FAR} those of {odometry.name})")


def _check_own_degrees(odometry: Samples) -> None:
    stride = max(1, round(_STEP_S / float(np.median(np.diff(odometry.t_s)))))
    path = odometry.only(np.arange(0, len(odometry), stride))
    steps = np.diff(path.xyz[:, :2], axis=0)
    course = np.arctan2(steps[:, 1], steps[:, 0])
    # The turn during a step is half of that between the steps around it.
    around = wrap(course[2:] - course[:-2]) / 2.0
    moves = np.linalg.norm(steps, axis=1) > _LEAST_STEP_M
    sure = moves[2:] & moves[1:-1] & moves[:-2] & (np.abs(around) > _TURN_RAD / 2.0)
    if _in_degrees(np.diff(path.yaw_rad)[1:-1][sure], around[sure]):
        raise RecordingError(f"{odometry.place}: {_DEGREES} ({_SO_FAR} its path does)")


def _turning_points(heading: Array) -> list[int]:
    """Return the indices of headings (n,) that differ by about 0.03 rad from one to the next."""
    picked = [0] if len(heading) else []
    for i, value in enumerate(heading.tolist()):
        if abs(value - heading[picked[-1]]) >= _TURN_RAD:
            picked.append(i)
    return picked


def _in_degrees(turned: Array, other: Array) -> bool:
    small = np.abs(other) < _LARGE_RAD  # beside outages turns are larger, and their errors too
    turned, other = turned[small], other[small]
    if len(turned) < _MIN_TURNS:
        return False
    fits, misfits = (float(np.mean(np.cos(turned - k * other))) for k in (_PER_DEGREE, 1.0))
    return fits > _FITS and misfits < _MISFITS

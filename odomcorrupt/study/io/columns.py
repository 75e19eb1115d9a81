"""Meaning and units of the columns of a text file, from its header.

Names are split into words: `field.pose.pose.position.x`, `pos_x [m]`, `p_RS_R_x [m]` and `x` are all x. Time, x and y
are required. Headings are optional, as yaw (theta, heading) or as a quaternion. Units are read from the names
(`yaw_deg`, `stamp [ns]`, `x_mm`). The defaults are metres and radians. Times without a unit are in s, ms, us or ns,
whichever brings the steps between the first lines closest to 50 ms, a usual period of odometry.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.study.io.topic_selection import near

if TYPE_CHECKING:
    from collections.abc import Sequence

_ROS = ("field", "header", "msg", "pose", "position", "pos", "p", "translation")
_WHOSE = ("odom", "odometry", "truth", "gt", "rs", "r")
_FILLERS = frozenset((*_ROS, *_WHOSE))
"""Words of a column name that are ignored."""
_LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "metres": 1.0, "meters": 1.0} | dict.fromkeys(("ft", "feet"), 0.3048)
_ANGLES = {"rad": 1.0, "deg": np.pi / 180.0, "radians": 1.0, "degrees": np.pi / 180.0}
_TICKS = {"s": 10**9, "sec": 10**9, "secs": 10**9, "seconds": 10**9, "ms": 10**6, "us": 10**3, "ns": 1}
_TIMES = ("stamp", "timestamp", "time", "t")
_YAWS = ("yaw", "theta", "heading", "th", "psi")
_ROTATIONS = frozenset({"q", "quat", "quaternion", "orientation", "rotation", "rot"})
_STEP_NS = 5e7  # usual period of odometry
_DATES = (9.5e17, 4.1e18)
"""The years 2000 and 2100 in nanoseconds since 1970."""
_FARTHEST = 9.2e18
"""Largest time in nanoseconds that fits in 64 bits."""
_NANOSECONDS = frozenset({"nsec", "nsecs", "nanosec", "nanosecs"})


@dataclass(frozen=True, slots=True)
class Columns:
    """Column indices of the quantities in a line, and their units.

    delimiter : None for white space
    count : number of cells in a line
    time, nanoseconds : the stamp, and a second column with its nanoseconds or None
    tick_ns : unit of the stamp in nanoseconds; None if it has to be inferred from the values
    xyz : columns of x, y and z (z may be None); metre is their unit in metres
    yaw : column of the heading or None; radian is its unit in radians
    quat : columns of x, y, z, w, or None
    """

    delimiter: str | None
    count: int
    time: int
    nanoseconds: int | None
    tick_ns: int | None
    xyz: tuple[int, int, int | None]
    metre: float = 1.0
    yaw: int | None = None
    radian: float = 1.0
    quat: tuple[int, int, int, int] | None = None


TUM = Columns(None, 8, 0, None, None, (1, 2, 3), quat=(4, 5, 6, 7))


@dataclass(frozen=True, slots=True)
class _Name:
    words: tuple[str, ...]
    unit: str


def find_columns(header: Sequence[str], delimiter: str, place: str) -> Columns:
    """Return the columns of time, position and heading according to a header.

    Raises
    ------
    RecordingError
        If a required column is missing or appears twice.
    """
    names = [_read(cell) for cell in header]

    def places(wanted: str) -> list[int]:
        return [i for i, name in enumerate(names) if name.words == (wanted,)]

    def one(wanted: str) -> int | None:
        found = places(wanted)
        if len(found) > 1:
            both = " and ".join(repr(header[i].strip()) for i in found[:2])
            raise RecordingError(f"{place}: columns {both} could both be {wanted}; rename or drop one")
        return found[0] if found else None

    x, y, z, nanoseconds = one("x"), one("y"), one("z"), one("nanoseconds")
    time = next((i for wanted in _TIMES if (i := one(wanted)) is not None), None)
    if time is None:
        time, nanoseconds = nanoseconds, None
    missing = [what for what, at in (("time", time), ("x", x), ("y", y)) if at is None]
    if time is None or x is None or y is None:
        there = near(missing[0], [cell.strip() for cell in header])
        raise RecordingError(
            f"{place}: no column for {' and '.join(missing)} ({there}); the first line must name time, x, y and yaw"
        )
    unit = names[time].unit
    tick = _TICKS.get(unit)
    if names[time].words == ("nanoseconds",):
        tick = 1
    elif nanoseconds is not None:
        tick = 10**9
    quats = [one(f"q{axis}") for axis in "xyzw"]
    whole = [i for i in quats if i is not None]
    yaw = next((i for wanted in _YAWS if (i := one(wanted)) is not None), None)
    angle = names[yaw].unit if yaw is not None else ""
    return Columns(
        delimiter=delimiter,
        count=len(header),
        time=time,
        nanoseconds=nanoseconds,
        tick_ns=tick,
        xyz=(x, y, z),
        metre=_LENGTHS.get(names[x].unit, 1.0),
        yaw=yaw,
        radian=_ANGLES.get(angle, 1.0),
        quat=(whole[0], whole[1], whole[2], whole[3]) if yaw is None and len(whole) == 4 else None,
    )


def guess_tick(times: Sequence[float]) -> int:
    """Return the most plausible unit of stamps, ns, from their steps and the date that they would give."""
    stamps = np.asarray(times)
    # Values too large for a stamp in any unit are refused later, with their line number.
    stamps = stamps[np.abs(stamps) < _FARTHEST]
    steps = np.abs(np.diff(stamps))
    steps = steps[steps > 0.0]
    if not len(steps):
        return 10**9

    def strangeness(tick: int) -> float:
        since = stamps[0] * tick
        return abs(float(np.log10(np.median(steps) * tick / _STEP_NS))) + (
            0.0 if _DATES[0] < since < _DATES[1] else 1.5
        )

    return min((10**9, 10**6, 10**3, 1), key=strangeness)


def _read(cell: str) -> _Name:
    """Return the significant words of a column's name, and its unit."""
    text = cell.lower().replace("µs", "us")
    words = [word for word in re.split(r"[^a-z0-9]+", text) if word]
    unit = words.pop() if len(words) > 1 and words[-1] in _LENGTHS | _ANGLES | _TICKS else ""
    kept = [word for word in words if word not in _FILLERS] or words[-1:]
    if len(kept) == 2 and kept[0] in _ROTATIONS and kept[1] in "xyzw":
        kept = [f"q{kept[1]}"]
    elif len(kept) == 2 and kept[0] == "t" and kept[1] in "xyz":
        kept = kept[1:]
    elif len(kept) == 1 and re.fullmatch(r"[pt][xyz]", kept[0]):
        kept = [kept[0][1]]
    elif kept and kept[-1] in _NANOSECONDS:
        kept = ["nanoseconds"]
    elif kept in (["sec"], ["secs"]):
        return _Name(("stamp",), "s")
    return _Name(tuple(kept), unit)

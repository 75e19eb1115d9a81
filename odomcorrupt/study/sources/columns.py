"""Which column of a text file holds what.

A header's names are read by their words: `field.pose.pose.position.x`, `pos_x [m]`, `p_RS_R_x [m]` and `x` are all x.
Needed are a time, x and y; headings come as yaw (theta, heading) or as a quaternion, and may be missing. Units stand
in the name (`yaw_deg`, `stamp [ns]`, `x_mm`); without them lengths are metres, angles radians, and times whatever makes
the steps between the first lines those of a robot: seconds up to 2 s a step, else milli-, micro- or nanoseconds.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.study.sources.choose import near

if TYPE_CHECKING:
    from collections.abc import Sequence

__all__ = ["TUM", "Columns", "find_columns", "guess_tick"]

_FILLERS = frozenset(
    {"field", "pose", "position", "pos", "p", "t", "odom", "odometry", "truth", "gt", "header", "msg", "rs", "r"}
)
_LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "metres": 1.0, "meters": 1.0}
_ANGLES = {"rad": 1.0, "deg": np.pi / 180.0, "radians": 1.0, "degrees": np.pi / 180.0}
_TICKS = {"s": 10**9, "sec": 10**9, "secs": 10**9, "seconds": 10**9, "ms": 10**6, "us": 10**3, "ns": 1, "nsec": 1}
_TIMES = ("stamp", "timestamp", "time", "t")
_YAWS = ("yaw", "theta", "heading", "th", "psi")
_ROTATIONS = frozenset({"q", "quat", "quaternion", "orientation", "rotation", "rot"})
_SECONDS = frozenset({"sec", "secs"})
_NANOSECONDS = frozenset({"nsec", "nsecs", "nanosec", "nanosecs"})


@dataclass(frozen=True, slots=True)
class Columns:
    """Places of the numbers in a line, and their units.

    delimiter : None for blanks
    count : how many cells a line has
    time, nanoseconds : the stamp, and the part of it that a second column adds (None)
    tick_ns : the unit of the stamp; None where the numbers must tell
    xyz : places of x, y and, or None, z; metre is what one of their units is
    yaw : place of the heading, or None; radian is what one of its units is
    quat : places of x, y, z, w, or None
    angle_named : whether the header says in which unit the heading is
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
    """Return where a header says that time, position and heading are.

    Raises
    ------
    RecordingError
        Where one of them is missing or there twice.

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

    x, y, z = one("x"), one("y"), one("z")
    seconds, nanoseconds = one("seconds"), one("nanoseconds")
    times = [i for wanted in _TIMES for i in places(wanted)]
    time = seconds if seconds is not None and not times else next(iter(times), None)
    missing = [what for what, at in (("a time (t, time or timestamp)", time), ("x", x), ("y", y)) if at is None]
    if time is None or x is None or y is None:
        there = near(missing[0].split(" (")[0], [cell.strip() for cell in header])
        raise RecordingError(f"{place}: no column for {' and '.join(missing)} ({there}); name them in the first line")
    if time == seconds:
        tick: int | None = 10**9
    else:
        tick = _TICKS.get(names[time].unit)
        nanoseconds = None
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
    """Return the unit of stamps in nanoseconds, by their size where they count from 1970, else by their steps."""
    stamps = np.asarray(times)
    largest = float(np.max(np.abs(stamps))) if len(stamps) else 0.0
    for least, tick in ((1e17, 1), (1e14, 10**3), (1e11, 10**6), (1e8, 10**9)):
        if largest > least:
            return tick
    steps = np.abs(np.diff(stamps))
    steps = steps[steps > 0.0]
    typical = float(np.median(steps)) if len(steps) else 0.0
    for most, tick in ((2.0, 10**9), (1.5e3, 10**6), (1.5e6, 10**3)):
        if typical < most:
            return tick
    return 1


def _read(cell: str) -> _Name:
    """Return a column's quantity as one word, where it is one that counts, and its unit."""
    text = cell.strip().strip("\"'").lstrip("#% ").lower()
    words = [word for word in re.split(r"[^a-z0-9µ]+", text.replace("µs", "us")) if word]
    unit = ""
    if len(words) > 1 and words[-1] in _LENGTHS | _ANGLES | _TICKS:
        unit = words.pop()
    kept = [word for word in words if word not in _FILLERS]
    if not kept and words and words[-1] in ("t", "stamp"):
        kept = [words[-1]]
    if len(kept) == 2 and kept[0] in _ROTATIONS and kept[1] in "xyzw":
        kept = [f"q{kept[1]}"]
    elif len(kept) == 1 and re.fullmatch(r"[pt][xyz]", kept[0]):
        kept = [kept[0][1]]
    elif len(kept) == 2 and kept[0] in _TIMES and (kept[1] in _SECONDS or kept[1] in _NANOSECONDS):
        kept = kept[1:]
    elif len(kept) == 1 and words and unit in _SECONDS | _NANOSECONDS and kept[0] == "stamp":
        # header.stamp.sec beside header.stamp.nanosec: the unit is the name
        return _Name((("seconds",) if unit in _SECONDS else ("nanoseconds",))[0:1], unit)
    if len(kept) == 1 and kept[0] in _SECONDS:
        return _Name(("seconds",), "s")
    if len(kept) == 1 and kept[0] in _NANOSECONDS:
        return _Name(("nanoseconds",), "ns")
    return _Name(tuple(kept), unit)

"""Reading of trajectories from TUM and CSV files, distinguished by content.

TUM: `stamp x y z qx qy qz qw` in seconds and metres, separated by white space; lines that begin with # are comments.
CSV: a header names the columns, of which time, x and y are required and a heading (yaw, theta, or a quaternion) is
optional. Names are split into words: `field.pose.pose.position.x`, `pos_x [m]`, `p_RS_R_x [m]` and `x` are all x.
Units are read from the names (`yaw_deg`, `stamp [ns]`, `x_mm`); the defaults are metres and radians. Times without a
unit are in s, ms, us or ns, by which a recording of 10 s or more has steps nearest to 50 ms, a usual period.
An export of OptiTrack Motive has a line each for the types, quantities and axes of its columns; Y is up, unless the
height changes far more than the way across. Lines have a largest length, because the input is untrusted.
"""

from __future__ import annotations

import csv
import io
import itertools
import re
from dataclasses import dataclass, replace
from decimal import Decimal
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.corruption.pose_faults import W_FIRST, ComponentOrder
from odomcorrupt.errors import RecordingError
from odomcorrupt.input_files import open_input
from odomcorrupt.study.io.raw_trajectory import READ_AS, Samples
from odomcorrupt.study.io.se3 import headings
from odomcorrupt.study.io.topic_selection import near

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence
    from pathlib import Path
    from typing import TextIO

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

_ROS = ("field", "header", "msg", "pose", "position", "pos", "p", "translation")
_FILLERS = frozenset((*_ROS, "odom", "odometry", "truth", "gt", "rs", "r"))
"""Words of a column name that are ignored."""
_LENGTHS = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "metres": 1.0, "meters": 1.0} | dict.fromkeys(("ft", "feet"), 0.3048)
_LENGTHS |= {"centimeters": 1e-2, "millimeters": 1e-3}
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
    y_up : whether y points up, and z to the right, as in Motive
    """

    delimiter: str | None
    count: int
    time: int
    nanoseconds: int | None
    tick_ns: int | None
    xyz: tuple[int, int, int | None]
    metre: float
    yaw: int | None
    radian: float
    quat: list[int] | None
    y_up: bool = False


class _Name(NamedTuple):
    words: tuple[str, ...]
    unit: str


def find_columns(header: Sequence[str], delimiter: str | None, place: str) -> Columns:
    """Return the columns of time, position and heading according to a header.

    Raises
    ------
    RecordingError
        If a required column is missing or appears twice.
    """
    names = [_read(cell) for cell in header]

    def one(wanted: str) -> int | None:
        found = [i for i, name in enumerate(names) if name.words == (wanted,)]
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
    unit = "ns" if names[time].words == ("nanoseconds",) else names[time].unit if nanoseconds is None else "s"
    quat = [i for axis in "xyzw" if (i := one(f"q{axis}")) is not None]
    yaw = next((i for wanted in _YAWS if (i := one(wanted)) is not None), None)
    return Columns(
        delimiter=delimiter,
        count=len(header),
        time=time,
        nanoseconds=nanoseconds,
        tick_ns=_TICKS.get(unit),
        xyz=(x, y, z),
        metre=_LENGTHS.get(names[x].unit, 1.0),
        yaw=yaw,
        radian=1.0 if yaw is None else _ANGLES.get(names[yaw].unit, 1.0),
        quat=quat if yaw is None and len(quat) == 4 else None,
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

    ticks = np.array([10**9, 10**6, 10**3, 1])
    dated = (_DATES[0] < stamps[0] * ticks) & (stamps[0] * ticks < _DATES[1])
    brief = np.ptp(stamps) * ticks < 200.0 * _STEP_NS  # 10 s, too short for a study
    return int(ticks[np.argmin(np.abs(np.log10(np.median(steps) * ticks / _STEP_NS)) + 1.5 * ~dated + 2.0 * brief)])


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


_MAX_LINES = 50_000_000  # lines
_BATCH = 16_384
_DELIMITERS = ",;\t"
_TUM = ("stamp", "x", "y", "z", "qx", "qy", "qz", "qw")
_BAGS = (b"#ROSBAG V", b"\x89MCAP", b"SQLite format 3")
_UNITS = {1: "nanoseconds", 10**3: "microseconds", 10**6: "milliseconds", 10**9: "seconds"}


def is_text(path: Path) -> bool:
    """Return whether a file is text: without a bag's magic number and without control characters."""
    if path.is_dir():
        return False
    with open_input(path, RecordingError) as stream:
        begin = stream.read(4096)
    return bool(begin) and not begin.startswith(_BAGS) and not any(byte < 9 or 13 < byte < 32 for byte in begin)


def read_text(path: Path, place: str) -> Samples:
    """Return the trajectory in a TUM or CSV file, as recorded.

    Raises
    ------
    RecordingError
        If the file is neither, or a line does not match its columns.
    """
    notes: list[str] = []
    with io.TextIOWrapper(open_input(path, RecordingError), "utf-8-sig", errors="replace", newline="") as stream:
        lines = read_lines(stream, place)
        columns, first = _begin(lines, place)
        more = (split_line(row, columns.delimiter) for row in lines if not row.cells[0].startswith("#"))
        rows = whole_rows(itertools.chain(first, more), columns.count, notes)
        stamps: list[NDArray[np.int64]] = []
        poses: list[Array] = []
        order = ComponentOrder()
        while batch := list(itertools.islice(rows, _BATCH)):
            if not stamps:
                tick = columns.tick_ns or guess_tick([row.number(columns.time) for row in batch])
                if columns.y_up:
                    across, height = np.nan_to_num(_poses(batch, columns, ComponentOrder()))[:, 1:3].std(axis=0)
                    columns = replace(columns, y_up=bool(height <= 10.0 * across))
            stamps.append(np.array([row.nanoseconds(columns.time, tick) for row in batch]))
            if columns.nanoseconds is not None:
                stamps[-1] += np.array([row.nanoseconds(columns.nanoseconds, 1) for row in batch])
            poses.append(_poses(batch, columns, order))
            if len(stamps) * _BATCH > _MAX_LINES:
                raise RecordingError(f"{place}: more than {_MAX_LINES} lines; thin it out")
    if not stamps:
        raise RecordingError(f"{place}: holds no line of numbers; nothing was recorded")
    if order.w_first:
        raise RecordingError(f"{place}: {W_FIRST}")
    if not columns.tick_ns and tick != 10**9:
        notes.append(f"{READ_AS} {_UNITS[tick]}")
    every = np.concatenate(poses)
    said = tuple(f"{path.name}: {note}" for note in notes)
    return Samples(place, path.name, "", np.concatenate(stamps), every[:, :3], every[:, 3], notes=said)


def _begin(lines: Iterator[Row], place: str) -> tuple[Columns, list[Row]]:
    """Return the columns, and the data lines already consumed to determine them."""
    for row in lines:
        line = row.cells[0]
        if line.startswith("#") and not any(mark in line for mark in _DELIMITERS):
            continue
        delimiter = next((mark for mark in _DELIMITERS if mark in line), None)
        cut = split_line(row, delimiter)
        if delimiter is None and are_numbers(cut):
            if len(cut.cells) == len(_TUM):
                return find_columns(_TUM, None, place), [cut]
            kind = "; KITTI poses have no stamps" if len(cut.cells) == 12 else ""
            found = f"{len(cut.cells)} numbers in line {row.line}{kind}"
            raise RecordingError(f"{place}: {found}; a TUM file has 8 (stamp x y z qx qy qz qw)")
        if delimiter is None:
            break
        if are_numbers(cut):
            raise RecordingError(f"{place}: its first line has no names; head it with time,x,y,yaw or the like")
        if cut.cells[0] == "Format Version":
            return replace(find_columns(_motive_header(cut, lines, place), delimiter, place), y_up=True), []
        return find_columns(cut.cells, delimiter, place), []
    raise RecordingError(f"{place}: is neither a bag nor a TUM or CSV file; TUM has 8 numbers a line, CSV a header")


def _motive_header(take: Row, lines: Iterator[Row], place: str) -> list[str]:
    """Return the names of the columns in an export of Motive, and read its header, which types begin and axes end."""
    unit = dict(zip(take.cells[::2], take.cells[1::2], strict=False)).get("Length Units", "")
    heads = [[""], [""]]
    while heads[-1][0] != "Frame" and (row := next(lines, None)):
        heads.append(split_line(row, ",").cells)
    kinds, named = [*heads, []][2], next((row for row in heads if row[1:2] == ["Name"]), [])
    bodies = dict.fromkeys(name for kind, name in zip(kinds, named, strict=False) if kind == "Rigid Body")
    if len(bodies) > 1:
        raise RecordingError(f"{place}: has the rigid bodies {' and '.join(bodies)}; export that of the robot alone")
    columns = zip(kinds, *heads[-2:], strict=False)
    names = (f"{quantity} {axis} {unit}" if kind == "Rigid Body" else "unused" for kind, quantity, axis in columns)
    return [*heads[-1][:2], *itertools.islice(names, 2, None)]


def _poses(rows: list[Row], columns: Columns, order: ComponentOrder) -> Array:
    """Return the positions and the headings (n, 4) in lines, m and rad; NaN without a heading."""

    def numbers(places: Iterable[int | None]) -> Array:
        values = np.array([[0.0 if at is None else row.number(at) for at in places] for row in rows])
        if columns.y_up:  # x, -z and y
            values[:, 1:3] = values[:, [2, 1]] * [-1.0, 1.0]
        return values

    xyz = numbers(columns.xyz) * columns.metre
    yaw = np.full(len(rows), np.nan)
    if columns.yaw is not None:
        yaw = numbers([columns.yaw])[:, 0] * columns.radian
    elif columns.quat is not None:
        quat_xyzw = numbers(columns.quat)
        order.take(xyz, quat_xyzw)
        yaw = headings(quat_xyzw)
    return np.column_stack((xyz, yaw))


_MAX_LINE = 65_536  # characters in a line


class Row(NamedTuple):
    """A line split into cells; `place` and `line` (counted from 1) are for messages."""

    place: str
    line: int
    cells: list[str]

    def number(self, at: int) -> float:
        """Return the number in a cell, NaN if it is empty."""
        cell = self.cells[at]
        try:
            return float(cell) if cell.strip() else float("nan")
        except ValueError as error:
            raise RecordingError(
                f"{self.place}: {cell[:40]!r} in line {self.line} is not a number; correct it"
            ) from error

    def nanoseconds(self, at: int, tick_ns: int) -> int:
        """Return the exact stamp in a cell; float64 seconds since 1970 would lose 100 ns and more."""
        rough = self.number(at) * tick_ns
        if not abs(rough) < _FARTHEST:
            raise RecordingError(
                f"{self.place}: {self.cells[at][:40]!r} in line {self.line} is not a stamp; correct it"
            )
        return round(Decimal(self.cells[at].strip()) * tick_ns) if rough else 0


def read_lines(stream: TextIO, place: str) -> Iterator[Row]:
    """Yield the non-blank lines, each as a row of one cell."""
    for count, line in enumerate(iter(lambda: stream.readline(_MAX_LINE), ""), start=1):
        if len(line) == _MAX_LINE:
            raise RecordingError(
                f"{place}: line {count} has more than {_MAX_LINE} characters; it is no TUM or CSV file"
            )
        if line.strip():
            yield Row(place, count, [line.strip()])


def split_line(row: Row, delimiter: str | None) -> Row:
    """Return the cells of a line; None splits at white space."""
    line = row.cells[0]
    return row._replace(cells=line.split() if delimiter is None else next(csv.reader([line], delimiter=delimiter)))


def whole_rows(rows: Iterable[Row], count: int, notes: list[str]) -> Iterator[Row]:
    """Yield complete rows; an incomplete last row (writing was interrupted) is left out with a note."""
    short: Row | None = None
    for row in rows:
        if short is not None:
            raise RecordingError(
                f"{short.place}: line {short.line} has {len(short.cells)} columns instead of {count}; correct it"
            )
        if len(row.cells) == count:
            yield row
        else:
            short = row
    if short is not None:
        notes.append("its last line is cut and left out")


def are_numbers(row: Row) -> bool:
    """Return whether all cells are numbers or empty."""
    try:
        for at in range(len(row.cells)):
            row.number(at)
    except RecordingError:
        return False
    return True

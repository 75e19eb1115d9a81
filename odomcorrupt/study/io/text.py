"""Reading of trajectories from TUM and CSV files, distinguished by content.

TUM: `stamp x y z qx qy qz qw` in seconds and metres, separated by white space; lines that begin with # are comments.
CSV: a header names the columns, see `columns`. Lines have a largest length, because the input is untrusted.
"""

from __future__ import annotations

import csv
import io
import itertools
from decimal import Decimal
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.corruption.pose_faults import W_FIRST, ComponentOrder
from odomcorrupt.errors import RecordingError
from odomcorrupt.input_files import open_input
from odomcorrupt.study.io.columns import TUM, Columns, find_columns, guess_tick
from odomcorrupt.study.io.raw_trajectory import Samples
from odomcorrupt.study.io.se3 import headings

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path
    from typing import TextIO

    from numpy.typing import NDArray

    from odomcorrupt.geometry.se2 import Array

_MAX_LINES = 50_000_000  # lines
_AHEAD = 1000  # lines read to infer the unit of the stamps
_BATCH = 16_384
_DELIMITERS = ",;\t"
_BAGS = (b"#ROSBAG V", b"\x89MCAP", b"SQLite format 3")
_UNITS = {1: "nanoseconds", 10**3: "microseconds", 10**6: "milliseconds", 10**9: "seconds"}


class _Part(NamedTuple):
    stamps_ns: NDArray[np.int64]
    xyz: Array
    yaw: Array


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
        ahead = list(itertools.islice(rows, _AHEAD))
        tick = columns.tick_ns or guess_tick([row.number(columns.time) for row in ahead])
        rows = itertools.chain(ahead, rows)
        parts, order = [], ComponentOrder()
        while batch := list(itertools.islice(rows, _BATCH)):
            parts.append(_part(batch, columns, tick, order))
            if len(parts) * _BATCH > _MAX_LINES:
                raise RecordingError(f"{place}: more than {_MAX_LINES} lines; thin it out")
    if not parts:
        raise RecordingError(f"{place}: holds no line of numbers; nothing was recorded")
    if order.w_first:
        raise RecordingError(f"{place}: {W_FIRST}")
    if not columns.tick_ns and tick != 10**9:
        notes.append(f"stamps read as {_UNITS[tick]}")
    none = np.zeros(0)
    return Samples(
        place=place,
        name=path.name,
        frame="",
        stamps_ns=np.concatenate([part.stamps_ns for part in parts]),
        xyz=np.concatenate([part.xyz for part in parts]),
        yaw_rad=np.concatenate([part.yaw for part in parts]),
        log_ns=none.astype(np.int64),
        variance_m2=none,
        notes=tuple(f"{path.name}: {note}" for note in notes),
    )


def _begin(lines: Iterator[Row], place: str) -> tuple[Columns, list[Row]]:
    """Return the columns, and the data lines already consumed to determine them."""
    for row in lines:
        line = row.cells[0]
        if line.startswith("#") and not any(mark in line for mark in _DELIMITERS):
            continue
        delimiter = next((mark for mark in _DELIMITERS if mark in line), None)
        cut = split_line(row, delimiter)
        count = len(cut.cells)
        if delimiter is None and are_numbers(cut):
            if count == TUM.count:
                return TUM, [cut]
            kind = "; KITTI poses have no stamps" if count == 12 else ""
            raise RecordingError(
                f"{place}: {count} numbers in line {row.line}{kind}; a TUM file has 8 (stamp x y z qx qy qz qw)"
            )
        if delimiter is None:
            break
        if are_numbers(cut):
            raise RecordingError(f"{place}: its first line has no names; head it with time,x,y,yaw or the like")
        return find_columns(cut.cells, delimiter, place), []
    raise RecordingError(f"{place}: is neither a bag nor a TUM or CSV file; TUM has 8 numbers a line, CSV a header")


def _part(rows: list[Row], columns: Columns, tick_ns: int, order: ComponentOrder) -> _Part:
    stamps = np.array([row.nanoseconds(columns.time, tick_ns) for row in rows])
    if columns.nanoseconds is not None:
        stamps += np.array([row.nanoseconds(columns.nanoseconds, 1) for row in rows])

    def numbers(places: Iterable[int | None]) -> Array:
        return np.array([[0.0 if at is None else row.number(at) for at in places] for row in rows])

    xyz = numbers(columns.xyz) * columns.metre
    if columns.yaw is not None:
        yaw = numbers([columns.yaw])[:, 0] * columns.radian
    elif columns.quat is not None:
        quat_xyzw = numbers(columns.quat)
        order.take(xyz, quat_xyzw)
        yaw = headings(quat_xyzw)
    else:
        yaw = np.full(len(rows), np.nan)
    return _Part(stamps, xyz, yaw)


_MAX_LINE = 65_536  # characters in a line
_LATEST_NS = 9.2e18  # largest stamp in 64 bits


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
        if not abs(rough) < _LATEST_NS:
            raise RecordingError(
                f"{self.place}: {self.cells[at][:40]!r} in line {self.line} is not a stamp; correct it"
            )
        return round(Decimal(self.cells[at].strip()) * tick_ns) if rough else 0


def read_lines(stream: TextIO, place: str) -> Iterator[Row]:
    """Yield the non-blank lines, each as a row of one cell."""
    count = 0
    while line := stream.readline(_MAX_LINE):
        count += 1
        if len(line) == _MAX_LINE:
            raise RecordingError(
                f"{place}: line {count} has more than {_MAX_LINE} characters; this is not a TUM or CSV file"
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

"""Read trajectories from text: TUM files and CSV files, told apart by their content.

TUM: `stamp x y z qx qy qz qw` in seconds and metres, separated by blanks; lines that begin with # are comments.
CSV: a header names the columns, see `columns`. Text comes from anybody: it is read line by line, of bounded length.
"""

from __future__ import annotations

import csv
import itertools
from decimal import Decimal
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.pose import yaw_from_quaternion
from odomcorrupt.study.sources.columns import TUM, Columns, find_columns, guess_tick
from odomcorrupt.study.sources.samples import Samples
from odomcorrupt.study.sources.spatial import unit

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from pathlib import Path
    from typing import TextIO

    from numpy.typing import NDArray

    from odomcorrupt.pose import Array

__all__ = ["is_text", "read_text"]

_LONGEST = 65_536
_MOST = 50_000_000
_AHEAD = 1000
_BATCH = 16_384
_DELIMITERS = ",;\t"
_BAGS = (b"#ROSBAG V", b"\x89MCAP", b"SQLite format 3")
_LATEST_NS = 9.2e18
_UNITS = {1: "nanoseconds", 10**3: "microseconds", 10**6: "milliseconds", 10**9: "seconds"}


class _Row(NamedTuple):
    number: int
    cells: list[str]


class _Part(NamedTuple):
    stamps_ns: NDArray[np.int64]
    xyz: Array
    yaw: Array


def is_text(path: Path) -> bool:
    """Tell whether a file is text: neither the magic of a bag nor bytes that no text has."""
    if path.is_dir():
        return False
    try:
        with path.open("rb") as stream:
            begin = stream.read(4096)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be opened: {error.strerror}") from error
    return bool(begin) and not begin.startswith(_BAGS) and not any(byte < 9 or 13 < byte < 32 for byte in begin)


def read_text(path: Path, place: str) -> Samples:
    """Read a TUM or CSV file, as recorded.

    Raises
    ------
    RecordingError
        Where it is neither, or a line does not hold what its file promises.

    """
    cut: list[str] = []
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as stream:
        lines = _lines(stream, place)
        columns, first = _begin(lines, place)
        rows = _whole(itertools.chain(first, _cells(lines, columns)), columns, place, cut)
        ahead = list(itertools.islice(rows, _AHEAD))
        tick = columns.tick_ns or guess_tick([_number(row.cells[columns.time], row, place) for row in ahead])
        rows = itertools.chain(ahead, rows)
        parts = []
        while batch := list(itertools.islice(rows, _BATCH)):
            parts.append(_part(batch, columns, tick, place))
            if len(parts) * _BATCH > _MOST:
                raise RecordingError(f"{place}: more than {_MOST} lines; thin it out")
    if not parts:
        raise RecordingError(f"{place}: holds no line of numbers; nothing was recorded")
    notes = [f"{path.name}: stamps read as {_UNITS[tick]}"] if not columns.tick_ns and tick != 10**9 else []
    notes += [f"{path.name}: {text}" for text in cut]
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
        notes=tuple(notes),
    )


def _lines(stream: TextIO, place: str) -> Iterator[_Row]:
    """Yield lines that are not blank, each as a row of one cell."""
    number = 0
    while line := stream.readline(_LONGEST):
        number += 1
        if len(line) == _LONGEST:
            raise RecordingError(f"{place}: line {number} has more than {_LONGEST} letters; this is no TUM or CSV file")
        if line.strip():
            yield _Row(number, [line.strip()])


def _begin(lines: Iterator[_Row], place: str) -> tuple[Columns, list[_Row]]:
    """Return the columns, and the lines of numbers that had to be read to know them."""
    for row in lines:
        line = row.cells[0]
        if line.startswith("#") and not any(mark in line for mark in _DELIMITERS):
            continue
        delimiter = next((mark for mark in _DELIMITERS if mark in line), None)
        cells = _split(line, delimiter)
        if delimiter is None and all(map(_is_number, cells)):
            if len(cells) == TUM.count:
                return TUM, [_Row(row.number, cells)]
            kind = "; KITTI poses have no stamps" if len(cells) == 12 else ""
            raise RecordingError(
                f"{place}: {len(cells)} numbers in line {row.number}{kind}; a TUM file has 8 (stamp x y z qx qy qz qw)"
            )
        if delimiter is None:
            break
        if all(map(_is_number, cells)):
            raise RecordingError(f"{place}: its first line has no names; head it with time,x,y,yaw or the like")
        return find_columns(cells, delimiter, place), []
    raise RecordingError(f"{place}: is neither a bag nor a TUM or CSV file; TUM has 8 numbers a line, CSV a header")


def _cells(lines: Iterable[_Row], columns: Columns) -> Iterator[_Row]:
    for row in lines:
        if not row.cells[0].startswith("#"):
            yield _Row(row.number, _split(row.cells[0], columns.delimiter))


def _whole(rows: Iterable[_Row], columns: Columns, place: str, cut: list[str]) -> Iterator[_Row]:
    """Yield rows with all their cells; the last one may be cut, because whoever wrote it may have been stopped."""
    short: _Row | None = None
    for row in rows:
        if short is not None:
            raise RecordingError(
                f"{place}: line {short.number} has {len(short.cells)} columns, {columns.count} are promised; mend it"
            )
        if len(row.cells) == columns.count:
            yield row
        else:
            short = row
    if short is not None:
        cut.append("its last line is cut and left out")


def _part(rows: list[_Row], columns: Columns, tick: int, place: str) -> _Part:
    stamps = np.empty(len(rows), np.int64)
    for i, row in enumerate(rows):
        stamps[i] = _nanoseconds(row.cells[columns.time], tick, row, place)
        if columns.nanoseconds is not None:
            stamps[i] += _nanoseconds(row.cells[columns.nanoseconds], 1, row, place)

    def numbers(places: Iterable[int | None]) -> Array:
        return np.array([[0.0 if at is None else _number(row.cells[at], row, place) for at in places] for row in rows])

    xyz = numbers(columns.xyz) * columns.metre
    if columns.yaw is not None:
        yaw = numbers([columns.yaw])[:, 0] * columns.radian
    elif columns.quat is not None:
        yaw = np.asarray(yaw_from_quaternion(unit(np.nan_to_num(numbers(columns.quat), posinf=np.nan, neginf=np.nan))))
    else:
        yaw = np.full(len(rows), np.nan)
    return _Part(stamps, xyz, yaw)


def _split(line: str, delimiter: str | None) -> list[str]:
    return line.split() if delimiter is None else next(csv.reader([line], delimiter=delimiter))


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return not cell.strip()
    return True


def _number(cell: str, row: _Row, place: str) -> float:
    try:
        return float(cell) if cell.strip() else float("nan")
    except ValueError as error:
        raise RecordingError(f"{place}: {cell[:40]!r} in line {row.number} is no number; mend it") from error


def _nanoseconds(cell: str, tick: int, row: _Row, place: str) -> int:
    """Return a stamp exactly: a float64 of seconds since 1970 would lose 100 ns and more."""
    rough = _number(cell, row, place) * tick
    if not abs(rough) < _LATEST_NS:
        raise RecordingError(f"{place}: {cell[:40]!r} in line {row.number} is no stamp; mend it")
    return round(Decimal(cell.strip()) * tick) if rough else 0

"""Rows of a text file, read line by line with limits on length, because the input is untrusted."""

from __future__ import annotations

import csv
from decimal import Decimal
from typing import TYPE_CHECKING, NamedTuple

from odomcorrupt.errors import RecordingError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from typing import TextIO

__all__ = ["Row", "are_numbers", "read_lines", "split_line", "whole_rows"]

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
            raise RecordingError(f"{self.place}: {cell[:40]!r} in line {self.line} is no number; mend it") from error

    def nanoseconds(self, at: int, tick_ns: int) -> int:
        """Return the exact stamp in a cell; float64 seconds since 1970 would lose 100 ns and more."""
        rough = self.number(at) * tick_ns
        if not abs(rough) < _LATEST_NS:
            raise RecordingError(f"{self.place}: {self.cells[at][:40]!r} in line {self.line} is no stamp; mend it")
        return round(Decimal(self.cells[at].strip()) * tick_ns) if rough else 0


def read_lines(stream: TextIO, place: str) -> Iterator[Row]:
    """Yield the non-blank lines, each as a row of one cell."""
    count = 0
    while line := stream.readline(_MAX_LINE):
        count += 1
        if len(line) == _MAX_LINE:
            raise RecordingError(f"{place}: line {count} has more than {_MAX_LINE} letters; this is no TUM or CSV file")
        if line.strip():
            yield Row(place, count, [line.strip()])


def split_line(row: Row, delimiter: str | None) -> Row:
    """Split a line into cells; None splits at white space."""
    line = row.cells[0]
    return row._replace(cells=line.split() if delimiter is None else next(csv.reader([line], delimiter=delimiter)))


def whole_rows(rows: Iterable[Row], count: int, notes: list[str]) -> Iterator[Row]:
    """Yield complete rows; an incomplete last row (writing was interrupted) is left out with a note."""
    short: Row | None = None
    for row in rows:
        if short is not None:
            raise RecordingError(
                f"{short.place}: line {short.line} has {len(short.cells)} columns, {count} are promised; mend it"
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

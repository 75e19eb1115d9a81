"""Read trajectories from text: TUM files and CSV files, told apart by their content.

TUM: `stamp x y z qx qy qz qw` in seconds and metres, separated by blanks; lines that begin with # are comments.
CSV: a header names the columns, see `columns`. Text comes from anybody: lines are read one by one, of bounded length.
"""

from __future__ import annotations

import csv
from decimal import Decimal
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from odomcorrupt.errors import RecordingError
from odomcorrupt.pose import yaw_from_quaternion
from odomcorrupt.study.sources.columns import Columns, find_columns, guess_tick
from odomcorrupt.study.sources.samples import Samples
from odomcorrupt.study.sources.spatial import unit

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import TextIO

__all__ = ["is_text", "read_text"]

_LONGEST = 65_536
_MOST_ROWS = 50_000_000
_BATCH = 16_384
_DELIMITERS = ",;\t"
_BAGS = (b"#ROSBAG V", b"\x89MCAP", b"SQLite format 3")
_LATEST_NS = float(2**63 - 1024)


class _Line(NamedTuple):
    number: int
    text: str


def is_text(path: Path) -> bool:
    """Tell whether a file is text: neither the magic of a bag nor bytes that no text has."""
    if path.is_dir():
        return False
    try:
        with path.open("rb") as stream:
            begin = stream.read(4096)
    except OSError as error:
        raise RecordingError(f"{path}: cannot be opened: {error.strerror}") from error
    if not begin or begin.startswith(_BAGS) or b"\0" in begin:
        return False
    return not any(byte < 9 or 13 < byte < 32 for byte in begin)


def read_text(path: Path, place: str) -> Samples:
    """Read a TUM or CSV file, as recorded.

    Raises
    ------
    RecordingError
        Where it is neither, or a line does not hold what its file promises.

    """
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as stream:
        lines = _lines(stream, place)
        columns, first = _begin(lines, place)
        values: list[np.ndarray] = []
        ticks: list[list[str]] = []
        rows = 0
        for batch in _batches(lines, first, columns, place):
            ticks.append([row[0] for row in batch.stamps])
            if columns.time_ns is not None:
                ticks[-1] = [f"{row[0]}|{row[1]}" for row in batch.stamps]
            values.append(batch.values)
            rows += len(batch.values)
            if rows > _MOST_ROWS:
                raise RecordingError(f"{place}: more than {_MOST_ROWS} lines; thin it out")
    return _samples(place, columns, ticks, values)

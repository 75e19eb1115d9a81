"""Recovery of the rows of a damaged sqlite3 file around unreadable pages."""

from __future__ import annotations

import shutil
import sqlite3
import struct
import tempfile
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from odomcorrupt.bags.rosbag2.database import columns

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from tempfile import _TemporaryFileWrapper

__all__ = ["copy_tables", "salvaged_rows", "whole_pages"]

_ROWS = "SELECT rowid, topic_id, timestamp, data FROM messages WHERE rowid >= ? ORDER BY rowid"
_GAPS = 2000
_KINDS = {"INTEGER", "TEXT", "BLOB", "TIMESTAMP"}
_TABLES = ("schema", "metadata", "topics", "message_definitions", "messages")


def whole_pages(path: Path) -> _TemporaryFileWrapper[bytes] | None:
    """Return a copy of a truncated file without its incomplete last page, which sqlite3 would fill with zeros."""
    with path.open("rb") as stream:
        (page,) = struct.unpack(">H", stream.read(18)[16:].rjust(2, b"\0"))
        size = path.stat().st_size
        rest = size % (65536 if page == 1 else max(page, 1))
        if not rest:
            return None
        stream.seek(0)
        whole = tempfile.NamedTemporaryFile(prefix="odomcorrupt")  # noqa: SIM115 - closed by the reader
        shutil.copyfileobj(stream, whole)
        whole.truncate(size - rest)
        return whole


def salvaged_rows(connection: sqlite3.Connection, name: str, losses: list[str]) -> Iterator[tuple[Any, ...]]:
    """Yield the readable messages in row order; add gaps to `losses`."""
    first: int | None = -(1 << 63)
    for _ in range(_GAPS):
        if first is None:
            return
        last = first
        try:
            for row in connection.execute(_ROWS, (first,)):
                if row[0] < last:
                    raise sqlite3.DatabaseError("rows are out of order")
                last = row[0] + 1
                yield row
        except sqlite3.Error as error:
            first = _next(connection, last)
            until = "the end" if first is None else f"row {first - 1}"
            since = "the first row" if last == -(1 << 63) else f"row {last}"
            losses.append(f"{name}: sqlite3 says {error}: messages from {since} to {until} are lost, if there were any")
        else:
            return
    losses.append(f"{name}: has more than {_GAPS} gaps, what lies behind them was not read")


def _next(connection: sqlite3.Connection, last: int) -> int | None:
    """Return the first readable row after an unreadable one; None where there is none."""
    begin = max(last, 0)
    step = 1
    found = None
    while step < 1 << 48 and found is None:
        try:
            row = connection.execute(_ROWS + " LIMIT 1", (begin + step,)).fetchone()
        except sqlite3.Error:
            step *= 2
            continue
        if row is None:
            break
        found = int(row[0])
    # Bisection between the last unreadable step and this one.
    low, high = begin + max(step // 2, 1), begin + step
    while low < high:
        middle = (low + high) // 2
        try:
            row = connection.execute(_ROWS + " LIMIT 1", (middle,)).fetchone()
        except sqlite3.Error:
            low = middle + 1
            continue
        high = middle
        if row is not None:
            found = int(row[0])
    return found if found is not None and found > last else None


def copy_tables(source: sqlite3.Connection, target: sqlite3.Connection) -> None:
    """Create a bag's tables in the target, with all rows except messages."""
    for table in _TABLES:
        rows = source.execute(f"PRAGMA table_info({table})").fetchall()
        if not rows:
            continue
        # Column names of rosbag2 are identifiers; others are not copied.
        known = [(str(row[1]), str(row[2]).upper()) for row in rows if str(row[1]).isidentifier()]
        kinds = [
            f'"{name}" INTEGER PRIMARY KEY' if name == "id" else f'"{name}" {kind if kind in _KINDS else ""}'
            for name, kind in known
        ]
        target.execute(f"CREATE TABLE {table} ({', '.join(kinds)})")
        if table != "messages":
            names = ", ".join(f'"{name}"' for name, _ in known)
            marks = ", ".join("?" for _ in known)
            with suppress(sqlite3.Error):
                for row in source.execute(f"SELECT {names} FROM {table}"):  # noqa: S608 - identifiers alone
                    target.execute(f"INSERT OR IGNORE INTO {table} VALUES ({marks})", row)  # noqa: S608 - as above
    if columns(target, "messages"):
        target.execute("CREATE INDEX timestamp_idx ON messages (timestamp ASC)")

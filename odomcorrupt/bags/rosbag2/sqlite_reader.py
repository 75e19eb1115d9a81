"""Reader of a sqlite3 file of rosbag2: blocks are batches of rows; rows around unreadable pages are recovered."""

from __future__ import annotations

import hashlib
import os
import sqlite3
import struct
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from odomcorrupt.bags.block import TABLE, Block, Channel, Framing, Kind
from odomcorrupt.bags.chunk import BATCH_BYTES
from odomcorrupt.bags.record_reader import Undecodable, with_readable
from odomcorrupt.bags.rosbag2.database import (
    columns,
    read_only,
    read_topics,
    reported,
    require_whole,
    second_at,
    settled,
)
from odomcorrupt.bags.source import ZSTD, not_the_end, temporary_copy, temporary_folder
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Container, Iterator, Mapping
    from contextlib import AbstractContextManager

    from numpy.typing import NDArray

    from odomcorrupt.bags.block import Definition

_ROWS = "SELECT rowid, topic_id, timestamp, data FROM messages WHERE rowid >= ? ORDER BY rowid"
_GAPS = 2000
_KINDS = {"INTEGER", "TEXT", "BLOB", "TIMESTAMP"}
_TABLES = ("schema", "metadata", "topics", "message_definitions", "messages")


def whole_pages(path: Path, copies: ExitStack, name: str, end: int = 0) -> Path:
    """Return a truncated file's copy without its incomplete last page, which sqlite3 would fill with zeros.

    end : byte at which another database begins, 0 if none does
    copies : removes the copy when it is closed
    """
    with path.open("rb") as stream:
        (page,) = struct.unpack(">H", stream.read(18)[16:].rjust(2, b"\0"))
        size = path.stat().st_size
        rest = size - end if end else size % (65536 if page == 1 else max(page, 1))
        if not rest:
            return path
        stream.seek(0)
        whole = temporary_copy(stream, temporary_folder(copies) / path.name, name)
    os.truncate(whole, size - rest)
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
            losses.append(
                f"{name}: sqlite3 reports {error}: messages from {since} to {until} are lost, if there were any"
            )
        else:
            return
    losses.append(f"{name}: has more than {_GAPS} gaps, messages after them were not read")


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


_PIECE_BYTES = 1 << 22
_LARGE_BYTES = 1 << 16


def kept(message: Any) -> bytes:
    """Return a message for comparison: its bytes, or the hash of a large one."""
    large = len(message) > _LARGE_BYTES
    return hashlib.blake2b(message, digest_size=32).digest() if large else bytes(message)


@dataclass(frozen=True, slots=True)
class SqliteFraming(Framing):
    """Framing of a block in its file.

    rows : (n,) row ids of the messages
    before : original messages as of `kept`, to detect changes; None for one that was not read
    """

    rows: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    before: list[bytes | None] = field(default_factory=list)


class SqliteReader:
    """One .db3 file.

    name : name in messages, by default its path
    readable : the file, a `settled` copy of it, or the whole pages of a truncated one
    damaged : whether sqlite3's integrity check fails; with recovery only
    packed : whether messages are compressed one by one
    losses : parts that could not be read, one sentence each, with recovery
    lost_rows : row ids of messages reported as lost
    count : number of messages of the last pass
    """

    kind: Kind = "sqlite3"
    complete = True
    channels: Mapping[int, Channel]

    def __init__(self, path: Path, name: str | None = None, *, recover: bool = False) -> None:
        self.name = name or str(path)
        self.path = path
        self.paths = [path]
        self.losses: list[str] = []
        self.lost_rows: list[int] = []
        self.count = 0
        self._recover = recover
        self._undecodable = Undecodable()
        self._copies = ExitStack()
        try:
            with self._reported():
                self.readable = settled(path, self.name, self._copies)
                if not recover:
                    require_whole(self.readable, self.name)
                end = second_at(self.readable)
                if end and not recover:
                    raise BagError(not_the_end(self.name, end))  # noqa: TRY301
                if recover:
                    self.losses += [not_the_end(self.name, end)] if end else []
                    self.readable = whole_pages(self.readable, self._copies, self.name, end)
            with self._reported(), closing(read_only(self.readable, whole=not recover)) as connection:
                self.channels = read_topics(connection, self.name, self.losses if recover else None)
                self.packed = _packed(connection, recover=recover)
                self.damaged = recover and not _sound(connection)
        except BaseException:
            self.__exit__(None, None, None)
            raise
        self._first_losses = len(self.losses)

    def _reported(self) -> AbstractContextManager[None]:
        return reported(Path(self.name), recover=self._recover)

    def definition(self, channel: Channel) -> Definition:
        """Return the file's definition of a channel's type."""
        definition: Definition = channel.raw
        return definition

    def blocks(self, only: Container[int] | None = None) -> Iterator[Block]:
        """Yield the blocks in the order of recording.

        only : channels whose messages are read; of others, large messages are listed without their bytes
        """
        del self.losses[self._first_losses :]
        self.lost_rows.clear()
        self.count = 0
        self._undecodable = Undecodable()
        if self._recover:
            only = with_readable(only, self.channels)
        with self._reported(), closing(read_only(self.readable, whole=not self._recover)) as connection:
            rows: list[int] = []
            of: list[int] = []
            times_ns: list[int] = []
            data: list[bytes | bytearray | None] = []
            size = unusable = 0
            first_unusable = ""
            last = -(1 << 63) - 1
            for row, channel, log_ns, blob, large in self._rows(connection, only):
                if row <= last:
                    # Cyclic pages could be read for ever.
                    raise BagError(f"{self.name}: message {row} comes after message {last}; the bag is damaged")
                last = row
                unread = only is not None and channel not in only and blob is None
                if large and not unread and channel in self.channels:
                    blob = _read_large(connection, row, large)  # noqa: PLW2901 - it is what the row has
                if (
                    not (unread or isinstance(blob, bytes | bytearray))
                    or channel not in self.channels
                    or type(log_ns) is not int
                ):
                    sentence = f"{self.name}: message {row} has no data, no time or no topic; the bag is damaged"
                    if not self._recover:
                        raise BagError(f"{sentence}; --recover saves the intact part")
                    first_unusable = first_unusable or sentence
                    unusable += 1
                    self.lost_rows.append(row)
                    continue
                rows.append(row)
                of.append(channel)
                times_ns.append(log_ns)
                data.append(blob)
                size += 0 if unread else len(blob)
                self.count += 1
                blob = None  # noqa: PLW2901 - the block holds the only reference
                if size >= BATCH_BYTES:
                    block = self._decodable(_block(rows, of, times_ns, data))
                    rows, of, times_ns, data, size = [], [], [], [], 0
                    yield block
                    del block
            if rows:
                yield self._decodable(_block(rows, of, times_ns, data))
        if unusable:
            self.losses.append(first_unusable + (f"; the same applies to {unusable - 1} more" if unusable > 1 else ""))
        self.losses += self._undecodable.losses(self.name)

    def _decodable(self, block: Block) -> Block:
        """Return a block, with recovery without the messages that cannot be decoded."""
        if not self._recover or self.packed:
            return block
        left_out = self._undecodable.find(block, self.channels)
        if not left_out.any():
            return block
        framing = block.raw
        assert isinstance(framing, SqliteFraming)  # noqa: S101 - `_block` makes no other
        rows = framing.rows
        self.lost_rows += rows[left_out].tolist()
        self.count -= int(np.count_nonzero(left_out))
        before = [one for one, lost in zip(framing.before, left_out.tolist(), strict=True) if not lost]
        return Block(block.data, block.table[~left_out], SqliteFraming(rows=rows[~left_out], before=before))

    def _rows(self, connection: sqlite3.Connection, only: Container[int] | None) -> Iterator[tuple[Any, ...]]:
        if self.damaged:
            return ((*row, 0) for row in salvaged_rows(connection, self.name, self.losses))
        wanted = list(self.channels) if only is None else [one for one in self.channels if one in only]
        ours = "1" if only is None else f"topic_id IN ({', '.join('?' * len(wanted))})"
        small = f"typeof(data) != 'blob' OR length(data) <= {_PIECE_BYTES}"
        return connection.execute(
            f"SELECT rowid, topic_id, timestamp, CASE WHEN {ours} AND ({small}) THEN data END, "  # noqa: S608 - question marks alone
            f"CASE WHEN {small} THEN 0 ELSE length(data) END FROM messages ORDER BY rowid",
            [] if only is None else wanted,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        self._copies.close()


def _read_large(connection: sqlite3.Connection, row: int, size: int) -> bytearray:
    """Return a large message, read in pieces to avoid three copies in memory."""
    out = bytearray(size)
    with connection.blobopen("messages", "data", row, readonly=True) as blob:
        for at in range(0, size, _PIECE_BYTES):
            out[at : at + _PIECE_BYTES] = blob.read(_PIECE_BYTES)
    return out


def _block(rows: list[int], of: list[int], times_ns: list[int], data: list[bytes | bytearray | None]) -> Block:
    table = np.empty(len(rows), dtype=TABLE)
    table["channel"], table["log_ns"] = of, times_ns
    table["length"] = [0 if blob is None else len(blob) for blob in data]
    table["offset"] = np.cumsum(table["length"]) - table["length"]
    read = [blob for blob in data if blob is not None]
    alone = read[0] if len(read) == 1 and isinstance(read[0], bytearray) else bytearray().join(read)
    joined = np.frombuffer(alone, dtype=np.uint8)
    before = [None if blob is None else kept(blob) for blob in data]
    return Block(joined, table, SqliteFraming(rows=np.array(rows, dtype=np.int64), before=before))


def _packed(connection: sqlite3.Connection, *, recover: bool) -> bool:
    """Return whether messages are compressed one by one; with recovery as the first readable one shows."""
    try:
        first = connection.execute("SELECT substr(data, 1, 4) FROM messages LIMIT 1").fetchone()
        return first is not None and first[0] == ZSTD
    except sqlite3.Error:
        if not recover:
            raise
    _, _, _, data = next(salvaged_rows(connection, "", []), (0, 0, 0, b""))
    return isinstance(data, bytes) and data.startswith(ZSTD)


def _sound(connection: sqlite3.Connection) -> bool:
    try:
        return bool(connection.execute("PRAGMA quick_check(1)").fetchone()[0] == "ok")
    except sqlite3.Error:
        return False

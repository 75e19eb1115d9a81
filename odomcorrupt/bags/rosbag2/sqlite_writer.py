"""Writers of sqlite3 files of rosbag2: a new one, and a copy in which rows are updated and inserted."""

from __future__ import annotations

import os
import shutil
import sqlite3
from collections import Counter
from contextlib import closing, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from odomcorrupt.bags.block import Channel, PartContents, require_all
from odomcorrupt.bags.definition import OutputChannels, retyped, with_common_text
from odomcorrupt.bags.output import FileCopy, beside, place, remove, sweep
from odomcorrupt.bags.rosbag2.database import columns, count_messages, harden, read_only, reported, unfinished
from odomcorrupt.bags.rosbag2.metadata import TopicInfo, add_provenance, edited, generated
from odomcorrupt.bags.rosbag2.sqlite_reader import SqliteFraming, SqliteReader, copy_tables, kept
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from odomcorrupt.bags.block import BagReader, Block, Definition


class SqliteOutput:
    """Base class of writers of one .db3 file, which appears when the context ends without an error, else nothing does.

    overwrite : whether it may replace a file
    """

    def __init__(self, path: Path, reader: BagReader, *, overwrite: bool) -> None:
        self._path = Path(os.path.realpath(path))
        self._partial = beside(self._path)
        self._overwrite = overwrite
        self._reader = reader
        self._open: sqlite3.Connection | None = None

    def settle(self) -> None:
        """Do nothing: rows are written immediately."""

    @property
    def _connection(self) -> sqlite3.Connection:
        if self._open is None:
            raise BagError(f"{self._path}: is not open")
        return self._open

    def _begin(self) -> None:
        """Make the temporary file."""

    def _complete(self) -> None:
        """Make the last changes, and commit."""

    def __enter__(self) -> Self:
        try:
            with reported(self._path, writing=True):
                sweep(self._path.parent, self._path.name)
                self._begin()
        except BaseException:
            self._discard()
            raise
        return self

    def _discard(self) -> None:
        if self._open is not None:
            self._open.close()
        remove(self._partial)

    def __exit__(self, kind: type[BaseException] | None, *_error: object) -> None:
        try:
            if kind is None:
                with reported(self._path, writing=True):
                    self._complete()
                    self._connection.close()
                    place(self._partial, self._path, overwrite=self._overwrite)
        finally:
            self._discard()


_SCHEMA_VERSION = 4
"""That of ROS 2 Iron and later."""
_TABLES = """
CREATE TABLE schema(schema_version INTEGER PRIMARY KEY, ros_distro TEXT NOT NULL);
CREATE TABLE metadata(id INTEGER PRIMARY KEY, metadata_version INTEGER NOT NULL, metadata TEXT NOT NULL);
CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL,
  serialization_format TEXT NOT NULL, offered_qos_profiles TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE message_definitions(id INTEGER PRIMARY KEY, topic_type TEXT NOT NULL, encoding TEXT NOT NULL,
  encoded_message_definition TEXT NOT NULL, type_description_hash TEXT NOT NULL);
CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL,
  data BLOB NOT NULL);
CREATE INDEX timestamp_idx ON messages (timestamp ASC);
"""
"""Tables and columns of rosbag2's sqlite3 storage."""
_METADATA_VERSION = 8


class NewSqliteWriter(SqliteOutput):
    """One .db3 file being created.

    overwrite : whether it may replace a file
    keeps_rest : whether messages not passed to `write` are in the output (False)
    """

    keeps_rest = False

    def __init__(self, path: Path, reader: BagReader, *, overwrite: bool = False) -> None:
        super().__init__(path, reader, overwrite=overwrite)
        self._rows: dict[int, int] = {}
        self._topics: dict[tuple[str, str, str], int] = {}
        self._infos: list[TopicInfo] = []
        self._defined: set[str] = set()
        self._channels = OutputChannels(reader, (1 << 32) - 1)
        self._provenance: list[tuple[str, Mapping[str, str]]] = []
        self._written = self._added = 0

    def add_channel(self, topic: str, msgtype: str, like: Channel, definition: Definition | None = None) -> Channel:
        """Add a topic with the encoding and QoS of another one, or of a definition; return it with a new id."""
        return self._channels.add(topic, msgtype, like.encoding, definition or retyped(self._reader, msgtype, like))

    def provenance(self, name: str, items: Mapping[str, str]) -> None:
        """Write provenance metadata to the file's metadata table."""
        self._provenance.append((name, items))

    def write(self, block: Block) -> None:
        """Insert the messages of a block, its added ones last."""
        view = block.data.data
        rows = [
            (self._row_of(channel), log_ns, view[offset : offset + length])
            for channel, log_ns, offset, length in block.table.tolist()
        ]
        rows += [(self._row_of(one.channel), one.log_ns, memoryview(one.data)) for one in block.added]
        with reported(self._path, writing=True):
            self._connection.executemany("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)", rows)
        self._written += len(rows)
        self._added += len(block.added)

    def contents(self) -> PartContents:
        """Return the message counts and time span of the file so far."""
        names = {row: key[0] for key, row in self._topics.items()}
        counts: dict[str, int] = {}
        with reported(self._path, writing=True):
            query = "SELECT topic_id, count(*) FROM messages GROUP BY topic_id"
            for row, count in self._connection.execute(query).fetchall():
                counts[names[row]] = counts.get(names[row], 0) + count
            query = "SELECT min(timestamp), max(timestamp) FROM messages"
            start_ns, end_ns = self._connection.execute(query).fetchone()
        return PartContents(self._path.name, counts, start_ns or 0, end_ns or 0)

    def _row_of(self, channel: int) -> int:
        """Return the id of a channel's row in the topics table, which is added at its first use."""
        if channel in self._rows:
            return self._rows[channel]
        one, definition = self._channels.described(channel)
        key = one.topic, one.msgtype, one.encoding
        known = key in self._topics  # a topic has one row, however many publishers it has
        row = self._rows[channel] = self._topics.setdefault(key, len(self._topics) + 1)
        if known:
            return row
        if not definition.text:
            definition = with_common_text(definition, one.msgtype, one.encoding)
        definition = definition._replace(name=one.msgtype)
        self._infos.append(TopicInfo(one.topic, one.encoding, definition))
        digest = definition.metadata.get("topic_type_hash", "")
        values = (row, *key, definition.metadata.get("offered_qos_profiles", ""), digest)
        with reported(self._path, writing=True):
            self._connection.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", values)
            if one.msgtype not in self._defined:
                self._defined.add(one.msgtype)
                text = definition.text.decode(errors="replace")
                described = (len(self._defined), one.msgtype, definition.encoding, text, digest)
                self._connection.execute("INSERT INTO message_definitions VALUES (?, ?, ?, ?, ?)", described)
        return row

    def _begin(self) -> None:
        self._open = sqlite3.connect(self._partial, isolation_level=None)
        # No journal: on any failure the whole file is removed.
        for pragma in ("journal_mode = OFF", "synchronous = OFF", "locking_mode = EXCLUSIVE"):
            self._open.execute(f"PRAGMA {pragma}").fetchall()
        self._open.executescript(_TABLES)
        self._open.execute("BEGIN")
        self._open.execute("INSERT INTO schema VALUES (?, ?)", (_SCHEMA_VERSION, ""))
        for channel in self._reader.channels if self._reader.complete else ():
            self._row_of(channel)

    def _complete(self) -> None:
        require_all(str(self._path), self._reader, self._written, self._added)
        text = generated("sqlite3", [self.contents()], self._infos, root=False)
        for name, items in self._provenance:
            text = edited(text, lambda info, name=name, items=items: add_provenance(info, name, items))  # type: ignore[misc]
        self._connection.execute("INSERT INTO metadata VALUES (1, ?, ?)", (_METADATA_VERSION, text))
        self._connection.execute("COMMIT")


_HELD_BYTES = 16 << 20
"""Blocks whose changes wait for the copy, bytes."""


class SqliteWriter(SqliteOutput):
    """One .db3 file being written.

    overwrite : whether it may replace a file
    copying_thread : whether the file is copied by a thread, while its messages are read
    keeps_rest : whether messages not passed to `write` are in the output (true unless the input is damaged)
    """

    def __init__(
        self, path: Path, reader: SqliteReader, *, overwrite: bool = False, copying_thread: bool = False
    ) -> None:
        super().__init__(path, reader, overwrite=overwrite)
        self._reader: SqliteReader = reader
        self.keeps_rest = not reader.damaged
        self._added: dict[int, str] = {}
        self._copying_thread = copying_thread
        self._copying: FileCopy | None = None
        self._waiting: list[tuple[str, list[Any]]] = []
        self._held_bytes = 0
        self._journal = ""
        self._expected: dict[int, tuple[int, int]] = {}
        self._changes = 0

    def add_channel(self, topic: str, msgtype: str, like: Channel, definition: Definition | None = None) -> Channel:
        """Add a topic with the encoding and QoS of another one, or of a definition; return it with a new id."""
        definition = definition or retyped(self._reader, msgtype, like)
        values = {
            "id": max([*self._reader.channels, *self._added], default=0) + 1,
            "name": topic,
            "type": msgtype,
            "serialization_format": like.encoding,
            "offered_qos_profiles": definition.metadata.get("offered_qos_profiles", ""),
            "type_description_hash": definition.metadata.get("topic_type_hash", ""),
        }
        with reported(self._path, writing=True):
            self._insert("topics", values)
            known = "SELECT 1 FROM message_definitions WHERE topic_type = ?"
            has = columns(self._connection, "message_definitions")
            if has and self._connection.execute(known, (msgtype,)).fetchone() is None:
                self._insert(
                    "message_definitions",
                    {
                        "topic_type": msgtype,
                        "encoding": definition.encoding,
                        "encoded_message_definition": definition.text.decode(errors="replace"),
                        "type_description_hash": values["type_description_hash"],
                    },
                )
        identifier = int(str(values["id"]))
        self._added[identifier] = topic
        return Channel(identifier, topic, msgtype, like.encoding)

    def provenance(self, name: str, items: Mapping[str, str]) -> None:
        """Write provenance metadata to the file's metadata table, where there is one."""
        with reported(self._path, writing=True):
            if not columns(self._connection, "metadata"):
                return
            for row, raw in self._connection.execute("SELECT rowid, CAST(metadata AS BLOB) FROM metadata").fetchall():
                # Unreadable metadata are kept.
                with suppress(BagError, UnicodeDecodeError):
                    new = edited((raw or b"").decode(), lambda info: add_provenance(info, name, items))
                    self._change("UPDATE metadata SET metadata = ? WHERE rowid = ?", [(new, row)])

    def write(self, block: Block) -> None:
        """Update the changed messages of a block, and insert its added ones."""
        framing = block.raw
        if not isinstance(framing, SqliteFraming):
            raise BagError(f"{self._path}: a bag of another format cannot become sqlite3; name the output .mcap")
        changed: list[tuple[bytes, int]] = []
        data = block.data.data
        # messages that were not read, or are empty, cannot have changed
        read = np.flatnonzero(block.table["length"])
        spans = zip(block.table["offset"][read].tolist(), block.table["length"][read].tolist(), strict=True)
        for at, row, (offset, length) in zip(read.tolist(), framing.rows[read].tolist(), spans, strict=True):
            now = data[offset : offset + length]
            if kept(now) != framing.before[at]:
                changed.append((now.tobytes(), row))
        with reported(self._path, writing=True):
            if self._reader.damaged:
                self._insert_all(block, framing)
            else:
                self._change("UPDATE messages SET data = ? WHERE rowid = ?", changed)
            self._change(
                "INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)",
                [(one.channel, one.log_ns, one.data) for one in block.added],
            )
            self._held_bytes += block.data.size
            if self._copying is not None and self._held_bytes > _HELD_BYTES:
                self._begin_changes()
        for one in block.added:
            self._expect(one.channel, len(one.data))

    def _change(self, statement: str, rows: list[Any]) -> None:
        """Execute an update for each of the given rows, or have it wait for the copy."""
        self._changes += len(rows)
        if self._copying is not None:
            self._waiting.append((statement, rows))
        else:
            self._connection.executemany(statement, rows)

    def _expect(self, topic: int, size: int, count: int = 1) -> None:
        known = self._expected.get(topic, (0, 0))
        self._expected[topic] = (known[0] + count, known[1] + size)

    def _insert_all(self, block: Block, framing: SqliteFraming) -> None:
        """Insert a block's messages into a newly created file."""
        rows = list(zip(framing.rows.tolist(), block.table.tolist(), strict=True))
        self._change(
            "INSERT INTO messages (rowid, topic_id, timestamp, data) VALUES (?, ?, ?, ?)",
            [(row, one[0], one[1], block.data[one[2] : one[2] + one[3]].tobytes()) for row, one in rows],
        )
        for _, (channel, _, _, length) in rows:
            self._expect(channel, length)

    def contents(self) -> PartContents:
        """Return the message counts and time span of the file so far."""
        names = {one.id: one.topic for one in self._reader.channels.values()} | self._added
        counts: Counter[str] = Counter()
        with reported(self._path, writing=True):
            self._drop_lost()
            # two queries, each of which the index of times answers; counts are compared when the file is complete
            ends = "SELECT (SELECT min(timestamp) FROM messages), (SELECT max(timestamp) FROM messages)"
            start_ns, end_ns = self._connection.execute(ends).fetchone()
        for topic, (count, _) in self._expected.items():
            counts[names.get(topic, "")] += count
        return PartContents(self._path.name, +counts, start_ns or 0, end_ns or 0)

    @property
    def _connection(self) -> sqlite3.Connection:
        if self._copying is not None:
            self._begin_changes()
        return super()._connection

    def _insert(self, table: str, values: Mapping[str, object]) -> None:
        known = [name for name in columns(self._connection, table) if name in values]
        marks = ", ".join("?" for _ in known)
        statement = f"INSERT INTO {table} ({', '.join(known)}) VALUES ({marks})"  # noqa: S608 - all names are ours
        self._change(statement, [[values[name] for name in known]])

    def _begin(self) -> None:
        if self._reader.damaged:
            with (
                closing(read_only(self._reader.readable, whole=False)) as source,
                closing(sqlite3.connect(self._partial, isolation_level=None)) as target,
            ):
                copy_tables(source, target)
        elif unfinished(self._reader.readable):
            # Part of the data is in the log, which only sqlite itself can merge.
            with closing(read_only(self._reader.readable)) as source, closing(sqlite3.connect(self._partial)) as target:
                source.backup(target)
        else:
            self._copied_to = self._partial.open("xb")
            self._copying = FileCopy(self._reader.readable, self._copied_to.fileno())
        if not self._reader.damaged:  # while a thread copies the file
            with reported(Path(self._reader.name)), closing(read_only(self._reader.readable, whole=False)) as source:
                self._expected = count_messages(source)
        if self._copying is None or not self._copying_thread:
            self._begin_changes()

    def _begin_changes(self) -> None:
        """Wait for the copy, begin the transaction, and make the changes that have waited."""
        if self._copying is not None:
            complete = self._copying.reaches()
            self._copying.require_unchanged()
            self._end_copy()
            if not complete:  # the kernel's copy is not available or has failed
                try:
                    shutil.copyfile(self._reader.readable, self._partial)
                except OSError as error:
                    raise BagError(f"{self._path}: cannot be written: {error.strerror}") from error
        self._open = sqlite3.connect(self._partial, isolation_level=None)
        (self._journal,) = self._connection.execute("PRAGMA journal_mode").fetchone()
        # No journal: on any failure the whole file is removed.
        for pragma in ("journal_mode = DELETE", "journal_mode = OFF", "synchronous = OFF", "locking_mode = EXCLUSIVE"):
            self._connection.execute(f"PRAGMA {pragma}").fetchall()
        harden(self._connection)
        self._connection.execute("BEGIN")
        waiting, self._waiting = self._waiting, []
        for statement, rows in waiting:
            self._connection.executemany(statement, rows)

    def _drop_lost(self) -> None:
        """Delete the rows reported as lost from the copy, which would be unreadable without recovery."""
        for row in self._reader.lost_rows:
            query = "SELECT topic_id, length(data) FROM messages WHERE rowid = ?"
            for topic, size in self._connection.execute(query, (row,)).fetchall():
                self._change("DELETE FROM messages WHERE rowid = ?", [(row,)])
                self._expect(topic, -(size or 0), -1)

    def _complete(self) -> None:
        self._drop_lost()
        done = self._connection.total_changes
        expected = {topic: seen for topic, seen in self._expected.items() if seen != (0, 0)}
        if done != self._changes or count_messages(self._connection) != expected:
            raise BagError(
                f"{self._path}: {self._changes} rows were to change and {done} did, or messages are missing that were "
                "not to be touched; the output is discarded, because the input's schema is not rosbag2's"
            )

        self._connection.execute("COMMIT")
        if self._journal == "wal":
            self._connection.execute("PRAGMA journal_mode = WAL").fetchall()

    def _discard(self) -> None:
        self._end_copy()
        super()._discard()

    def _end_copy(self) -> None:
        if self._copying is not None:
            self._copying.close()
            self._copying = None
            self._copied_to.close()

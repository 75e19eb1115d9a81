"""Writer of a new sqlite3 file of rosbag2, for messages of any bag."""

from __future__ import annotations

import sqlite3
from typing import TYPE_CHECKING, Self

from odomcorrupt.bags.block import Channel, PartContents, require_all
from odomcorrupt.bags.definition import with_common_text
from odomcorrupt.bags.placement import sweep
from odomcorrupt.bags.rosbag2.database import reported
from odomcorrupt.bags.rosbag2.metadata import TopicInfo, add_provenance, edited, generated
from odomcorrupt.bags.rosbag2.sqlite_output import SqliteOutput
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from odomcorrupt.bags.block import BagReader, Block, Definition

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
        self._fresh: dict[int, tuple[Channel, Definition]] = {}
        self._provenance: list[tuple[str, Mapping[str, str]]] = []
        self._written = self._added = 0

    def add_defined(self, topic: str, msgtype: str, encoding: str, definition: Definition) -> Channel:
        """Add a topic with a given definition; return it."""
        identifier = (1 << 32) - 1
        while identifier in self._fresh or identifier in self._reader.channels:
            identifier -= 1
        channel = Channel(identifier, topic, msgtype, encoding)
        self._fresh[identifier] = channel, definition
        return channel

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
        if channel not in self._rows:
            if channel in self._fresh:
                known, definition = self._fresh[channel]
            elif channel in self._reader.channels:
                known = self._reader.channels[channel]
                definition = self._reader.definition(known)
            else:
                raise BagError(f"channel {channel}: is neither in the bag nor added to it")
            self._rows[channel] = self._topic_row(known, definition)
        return self._rows[channel]

    def _topic_row(self, channel: Channel, definition: Definition) -> int:
        """Return the row of a topic, which has one however many publishers it has."""
        key = channel.topic, channel.msgtype, channel.encoding
        if key in self._topics:
            return self._topics[key]
        row = self._topics[key] = len(self._topics) + 1
        if not definition.text:
            definition = with_common_text(definition, channel.msgtype, channel.encoding)
        definition = definition._replace(name=channel.msgtype)
        self._infos.append(TopicInfo(channel.topic, channel.encoding, definition))
        digest = definition.metadata.get("topic_type_hash", "")
        values = (row, *key, definition.metadata.get("offered_qos_profiles", ""), digest)
        with reported(self._path, writing=True):
            self._connection.execute("INSERT INTO topics VALUES (?, ?, ?, ?, ?, ?)", values)
            if channel.msgtype not in self._defined:
                self._defined.add(channel.msgtype)
                text = definition.text.decode(errors="replace")
                described = (len(self._defined), channel.msgtype, definition.encoding, text, digest)
                self._connection.execute("INSERT INTO message_definitions VALUES (?, ?, ?, ?, ?)", described)
        return row

    def __enter__(self) -> Self:
        try:
            with reported(self._path, writing=True):
                sweep(self._path.parent, self._path.name)
                self._open = sqlite3.connect(self._partial, isolation_level=None)
                # No journal: on any failure the whole file is removed.
                for pragma in ("journal_mode = OFF", "synchronous = OFF", "locking_mode = EXCLUSIVE"):
                    self._open.execute(f"PRAGMA {pragma}").fetchall()
                self._open.executescript(_TABLES)
                self._open.execute("BEGIN")
                self._open.execute("INSERT INTO schema VALUES (?, ?)", (_SCHEMA_VERSION, ""))
                if self._reader.complete:
                    for channel in self._reader.channels:
                        self._row_of(channel)
        except BaseException:
            self._discard()
            raise
        return self

    def _complete(self) -> None:
        require_all(str(self._path), self._reader, self._written, self._added)
        text = generated("sqlite3", [self.contents()], self._infos, root=False)
        for name, items in self._provenance:
            text = edited(text, lambda info, name=name, items=items: add_provenance(info, name, items))  # type: ignore[misc]
        self._connection.execute("INSERT INTO metadata VALUES (1, ?, ?)", (_METADATA_VERSION, text))
        self._connection.execute("COMMIT")

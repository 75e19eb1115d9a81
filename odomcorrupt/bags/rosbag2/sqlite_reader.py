"""Read a sqlite3 file of rosbag2 as blocks: batches of rows."""

from __future__ import annotations

import json
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Self

import numpy as np

from odomcorrupt.bags.block import TABLE, Block, Channel, Kind
from odomcorrupt.bags.rosbag2.database import Topic, read_only, read_topics, reported
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    import sqlite3
    from collections.abc import Container, Iterator, Mapping
    from pathlib import Path
    from types import TracebackType

    from numpy.typing import NDArray

    from odomcorrupt.bags.definition import Definition

__all__ = ["SqliteFraming", "SqliteReader"]

_BATCH_BYTES = 1 << 20


@dataclass(frozen=True, slots=True)
class SqliteFraming:
    """How a block stood in its file.

    rows : (n,) row ids of the messages
    before : the messages as they were read, to tell which were changed
    """

    rows: NDArray[np.int64]
    before: list[bytes]


class SqliteReader:
    """One .db3 file."""

    kind: Kind = "sqlite3"
    complete = True

    def __init__(self, path: Path) -> None:
        self.name = str(path)
        self.path = path
        self.paths = [path]
        self.losses: list[str] = []  # sqlite recovers by itself or not at all
        with reported(path), closing(read_only(path)) as connection:
            topics = read_topics(connection, path)
        self.channels: Mapping[int, Channel] = {
            topic.id: Channel(topic.id, topic.name, topic.type, topic.encoding, raw=topic) for topic in topics
        }

    def definition(self, channel: Channel) -> Definition:
        """Return what the file says of a channel's type."""
        topic: Topic = channel.raw
        return topic.definition()

    def blocks(self, only: Container[int] | None = None) -> Iterator[Block]:
        """Yield the blocks in the order in which messages were recorded, of some channels or of all."""
        with reported(self.path), closing(read_only(self.path)) as connection:
            rows: list[int] = []
            head: list[tuple[int, int]] = []
            data: list[bytes] = []
            size = 0
            for row, channel, log_ns, blob in self._rows(connection, only):
                if not isinstance(blob, bytes) or channel not in self.channels or not isinstance(log_ns, int):
                    raise BagError(f"{self.path}: message {row} has no data or no topic; the bag is damaged")
                rows.append(row)
                head.append((channel, log_ns))
                data.append(blob)
                size += len(blob)
                if size >= _BATCH_BYTES:
                    yield _block(rows, head, data)
                    rows, head, data, size = [], [], [], 0
            if rows:
                yield _block(rows, head, data)

    def _rows(self, connection: sqlite3.Connection, only: Container[int] | None) -> sqlite3.Cursor:
        if only is None:
            return connection.execute("SELECT rowid, topic_id, timestamp, data FROM messages ORDER BY rowid")
        wanted = json.dumps([one for one in self.channels if one in only])
        return connection.execute(
            "SELECT rowid, topic_id, timestamp, data FROM messages "
            "WHERE topic_id IN (SELECT value FROM json_each(?)) ORDER BY rowid",
            (wanted,),
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass


def _block(rows: list[int], head: list[tuple[int, int]], data: list[bytes]) -> Block:
    table = np.empty(len(rows), dtype=TABLE)
    table["channel"], table["log_ns"] = np.array(head, dtype=np.int64).T
    table["length"] = [len(blob) for blob in data]
    table["offset"] = np.cumsum(table["length"]) - table["length"]
    joined = np.frombuffer(bytearray().join(data), dtype=np.uint8)
    return Block(joined, table, SqliteFraming(np.array(rows, dtype=np.int64), data))

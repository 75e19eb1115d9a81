"""A sqlite3 file of rosbag2 under a temporary name until it is complete: what its writers share."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING

from odomcorrupt.bags.definition import retyped
from odomcorrupt.bags.placement import beside, place, remove
from odomcorrupt.bags.rosbag2.database import reported
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    import sqlite3

    from odomcorrupt.bags.block import BagReader, Channel, Definition


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

    def add_channel(self, topic: str, msgtype: str, like: Channel) -> Channel:
        """Add a topic with the encoding and QoS of another one; return it with a new id."""
        return self.add_defined(topic, msgtype, like.encoding, retyped(self._reader, msgtype, like))

    def add_defined(self, topic: str, msgtype: str, encoding: str, definition: Definition) -> Channel:
        """Add a topic with a given definition; return it."""
        raise NotImplementedError

    def settle(self) -> None:
        """Do nothing: rows are written immediately."""

    @property
    def _connection(self) -> sqlite3.Connection:
        if self._open is None:
            raise BagError(f"{self._path}: is not open")
        return self._open

    def _complete(self) -> None:
        """Make the last changes, and commit."""
        raise NotImplementedError

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

"""The sqlite3 files of rosbag2: topics and type definitions, in all versions of the tables."""

from __future__ import annotations

import os
import re
import sqlite3
import struct
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import quote

from odomcorrupt.bags.block import Channel, Definition
from odomcorrupt.bags.rosbag2.bounded_yaml import shown
from odomcorrupt.bags.source import SQLITE, temporary_copy, temporary_folder
from odomcorrupt.errors import BagError

if TYPE_CHECKING:
    from collections.abc import Iterator

_LEAST_BYTES = 1 << 20
_MOST_BYTES = (1 << 31) - 1
"""More is no limit to sqlite3, and too large a number."""
_IDS = 1 << 32
"""Ids of topics are less; recorders count them from 1."""
_COLUMNS = {"topics": {"id", "name", "type"}, "messages": {"topic_id", "timestamp", "data"}}
"""Tables and columns without which nothing can be read."""
_TABLES = ("schema", "metadata", "topics", "message_definitions", "messages")
_RULES = re.compile(r"\b(?:CHECK|CONFLICT|GENERATED|AS|WITHOUT|REFERENCES)\b", re.IGNORECASE)
"""Words of a table's definition that make more of it than columns: what is written could be changed or thrown away."""
_ROW_IDS = {"rowid", "oid", "_rowid_"}
_JOURNAL = bytes.fromhex("d9d505f920a163d7")
"""Beginning of a rollback journal, and end of one that names a journal of several databases."""
_SURROUNDINGS = (
    sqlite3.SQLITE_PERM, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_NOMEM, sqlite3.SQLITE_READONLY,
    sqlite3.SQLITE_FULL, sqlite3.SQLITE_CANTOPEN,
)  # fmt: skip
"""Errors that do not come from a damaged file."""
_SWITCHES = {
    "SQLITE_DBCONFIG_ENABLE_TRIGGER": False,
    "SQLITE_DBCONFIG_ENABLE_VIEW": False,
    "SQLITE_DBCONFIG_TRUSTED_SCHEMA": False,
    "SQLITE_DBCONFIG_DEFENSIVE": True,
}
"""What SQLite advises for files of strangers (https://sqlite.org/security.html); Python sets them from 3.12 on."""


@contextmanager
def reported(path: Path, *, writing: bool = False, recover: bool = False) -> Iterator[None]:
    """Convert sqlite's errors to BagError with the file's name.

    recover : whether recovery is active, so that messages do not advise it
    """
    try:
        yield
    except (OSError, MemoryError, sqlite3.Error, UnicodeDecodeError, OverflowError) as error:
        if isinstance(error, BagError):
            raise
        if writing:
            reason = error.strerror if isinstance(error, OSError) else f"sqlite3 reports {error}"
            raise BagError(f"{path}: cannot be written: {reason}") from error
        # sqlite3 quotes the whole text that it cannot decode
        reason = shown(error) or type(error).__name__
        if isinstance(error, OSError | MemoryError) or getattr(error, "sqlite_errorcode", 0) & 0xFF in _SURROUNDINGS:
            raise BagError(f"{path}: cannot be read: {getattr(error, 'strerror', None) or reason}") from error
        advice = "" if recover else "; --recover saves the intact part"
        raise BagError(f"{path}: sqlite3 reports {reason}; the bag is truncated or damaged{advice}") from error


def unfinished(path: Path) -> list[Path]:
    """Return the files beside a database that are part of it, because its recorder is running or was killed.

    A write-ahead log holds the latest data; a rollback journal, the earlier state of pages that were being changed.
    """
    log, journal = (Path(os.path.realpath(path) + end) for end in ("-wal", "-journal"))
    found = [log] if log.is_file() and log.stat().st_size else []
    if journal.is_file():
        with journal.open("rb") as stream:
            # its header is zeroed once a transaction is complete
            found += [journal] if stream.read(1).strip(b"\0") else []
    return found


def settled(path: Path, name: str, copies: ExitStack) -> Path:
    """Return a file that can be read as it is: the database, or a copy in which sqlite3 has finished what was begun.

    A log is read in place if its index exists, as beside a running recorder; sqlite3 would create one.

    copies : removes the copy when it is closed
    """
    beside, index = unfinished(path), Path(os.path.realpath(path) + "-shm")
    if not beside or (index.is_file() and not any(one.name.endswith("-journal") for one in beside)):
        return path
    folder = temporary_folder(copies)
    files = [Path(os.path.realpath(path)), *beside]
    before = [(one.stat().st_size, one.stat().st_mtime_ns) for one in files]
    for file in files:
        with file.open("rb") as stream:
            temporary_copy(stream, folder / file.name, name)
            stream.seek(max(stream.tell() - len(_JOURNAL), 0))
            if file.name.endswith("-journal") and stream.read() == _JOURNAL:
                # sqlite3 would delete the file that such a journal names
                raise BagError(f"{name}: its journal is one of several databases; open the bag with sqlite3 first")
    if before != [(one.stat().st_size, one.stat().st_mtime_ns) for one in files]:
        raise BagError(f"{name}: changed while it was read; run again once the recording is complete")
    with closing(sqlite3.connect(folder / files[0].name, isolation_level=None)) as connection:
        harden(connection)
        connection.execute("SELECT count(*) FROM sqlite_master").fetchall()
        connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
    return folder / files[0].name


def read_only(path: Path, *, whole: bool = True) -> sqlite3.Connection:
    """Return a connection to a `settled` file that writes nothing, not even sqlite's lock files.

    whole : False to read the rest of a truncated file
    """
    beside = unfinished(path)
    mode = "mode=ro&readonly_shm=1" if beside else "immutable=1"
    connection = sqlite3.connect(f"file:{quote(str(path.absolute()))}?{mode}", uri=True)
    # No message is larger than its file, whatever it claims.
    size = sum(one.stat().st_size for one in (path, *beside))
    connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, min(max(size, _LEAST_BYTES), _MOST_BYTES))
    if not whole:
        # Lets sqlite read the rest of a truncated file; nothing is ever written.
        connection.execute("PRAGMA writable_schema = ON")
    harden(connection, defensive=whole)
    return connection


def second_at(path: Path) -> int:
    """Return the byte at which another database follows the first, which sqlite3 would not read; 0 if none does."""
    with path.open("rb") as stream:
        (page, pages) = struct.unpack(">H10xI", stream.read(32)[16:].rjust(16, b"\0"))
        end = (65536 if page == 1 else page) * pages
        stream.seek(end)
        return int(end) if end and stream.read(len(SQLITE)) == SQLITE else 0


def harden(connection: sqlite3.Connection, *, defensive: bool = True) -> None:
    """Disable triggers, views and functions of a file's schema.

    defensive : False to read the schema of a truncated file
    """
    connection.execute("PRAGMA trusted_schema = OFF").fetchall()
    connection.execute("PRAGMA cell_size_check = ON").fetchall()
    for name, on in _SWITCHES.items():
        if hasattr(sqlite3, name):
            connection.setconfig(getattr(sqlite3, name), on and defensive)  # type: ignore[attr-defined,unused-ignore]


def require_plain(connection: sqlite3.Connection, path: str) -> None:
    """Raise BagError for a file whose schema can change what is read or written.

    Raises
    ------
    BagError
        If there is a trigger or a view, or a table of rosbag2 that computes, checks or replaces rows.
    """
    for kind, name, table, text in connection.execute("SELECT type, name, tbl_name, sql FROM sqlite_master"):
        if kind in ("trigger", "view"):
            fault = f"has a {kind}, {name!r}"
        elif kind == "table" and name in _TABLES and _ROW_IDS & {one.lower() for one in columns(connection, name)}:
            fault = f"its table {name} has a column of the name of sqlite3's row numbers"
        elif kind == "table" and name in _TABLES and _RULES.search(str(text)):
            fault = f"its table {name} has constraints ({shown(text)})"
        elif kind == "index" and table in _TABLES and text is not None and not _is_plain_index(connection, name):
            fault = f"its table {table} has an index that computes, {name!r}"
        elif kind == "table" and str(text).upper().startswith("CREATE VIRTUAL"):
            fault = f"has a virtual table, {name!r}"
        else:
            continue
        raise BagError(f"{path}: {fault}: no recorder makes that, and it could change what is written; remove it")


def _is_plain_index(connection: sqlite3.Connection, name: str) -> bool:
    """Return whether an index is one of whole columns and of all rows."""
    quoted = '"' + name.replace('"', '""') + '"'
    fields = connection.execute(f"PRAGMA index_info({quoted})").fetchall()
    (text,) = connection.execute("SELECT sql FROM sqlite_master WHERE type = 'index' AND name = ?", (name,)).fetchone()
    return all(field[1] >= 0 for field in fields) and not re.search(r"\bWHERE\b", str(text), re.IGNORECASE)


def count_messages(connection: sqlite3.Connection) -> dict[int, tuple[int, int]]:
    """Return the number of messages and bytes of each topic id, without reading messages."""
    # The limit keeps sqlite from sorting messages together with their data, in files of its own.
    sizes = "SELECT topic_id, length(data) AS size FROM messages LIMIT -1"
    query = f"SELECT topic_id, count(*), total(size) FROM ({sizes}) GROUP BY topic_id"  # noqa: S608 - as it stands here
    return {topic: (count, int(size)) for topic, count, size in connection.execute(query)}


def columns(connection: sqlite3.Connection, table: str) -> list[str]:
    """Return the names of a table's columns; none where there is no such table."""
    return [str(row[1]) for row in connection.execute(f"PRAGMA table_info({table})")]


def read_topics(connection: sqlite3.Connection, path: str, losses: list[str] | None = None) -> dict[int, Channel]:
    """Return the topics by id, in all versions of the tables, each with its definition as rosbag2 writes it to an MCAP.

    losses : with recovery, for what of the topics and definitions cannot be read, one sentence for each table

    Raises
    ------
    BagError
        If the tables are not those of rosbag2.
    """
    tables = {str(name) for (name,) in connection.execute("SELECT name FROM sqlite_master WHERE type = 'table'")}
    # A view may run for ever, and no recorder creates one.
    known = all(wanted <= set(columns(connection, table)) for table, wanted in _COLUMNS.items())
    if not (known and _COLUMNS.keys() <= tables):
        raise BagError(f"{path}: is a sqlite3 database without rosbag2's topics and messages")
    require_plain(connection, path)
    definitions: dict[str, tuple[str, bytes]] = {}
    if columns(connection, "message_definitions"):
        # as bytes: recorders copy what a package holds, in whatever encoding
        query = "SELECT topic_type, encoding, CAST(encoded_message_definition AS BLOB) FROM message_definitions"
        for row in _readable(connection, query, "definitions of message types", path, losses):
            definitions[row[0]] = row[1], row[2]
    names = columns(connection, "topics")
    topics: dict[int, Channel] = {}
    for values in _readable(connection, "SELECT * FROM topics ORDER BY id", "topics", path, losses):
        of: dict[str, Any] = dict(zip(names, values, strict=True))
        number, topic, msgtype = (of[name] for name in ("id", "name", "type"))
        serialised = of.get("serialization_format") or "cdr"
        qos, digest = (of.get(name) or "" for name in ("offered_qos_profiles", "type_description_hash"))
        encoding, text = definitions.get(msgtype, ("", b""))
        sound = all(isinstance(one, str) for one in (topic, msgtype, serialised, qos, digest, encoding))
        if not (sound and isinstance(number, int) and isinstance(text, bytes)):
            raise BagError(f"{path}: topic {topic!r} with id {number!r} is invalid; the bag is damaged")
        if not 0 <= number < _IDS or number in topics:
            raise BagError(
                f"{path}: topic {topic!r} has the id {number}, which is negative, too large or already used; the bag "
                "is damaged"
            )
        metadata = {"offered_qos_profiles": qos} | ({"topic_type_hash": digest} if digest else {})
        definition = Definition(msgtype, encoding, text, metadata)
        topics[number] = Channel(number, topic, msgtype, serialised, raw=definition)
    if losses and not topics:
        raise BagError(losses[-1])
    return topics


def _readable(
    connection: sqlite3.Connection, query: str, what: str, path: str, losses: list[str] | None
) -> Iterator[tuple[Any, ...]]:
    """Yield rows; with recovery those before the first one that sqlite3 cannot read, which is put into `losses`."""
    try:
        yield from connection.execute(query)
    except sqlite3.Error as error:
        if losses is None:
            raise
        losses.append(f"{path}: sqlite3 reports {shown(error)}: some {what} are lost")


def require_whole(path: Path, name: str) -> None:
    """Raise BagError for a file shorter than its header says; sqlite would fail only at a missing page."""
    with path.open("rb") as stream:
        head = stream.read(100)
    if len(head) < 100:
        raise BagError(f"{name}: has {len(head)} bytes, less than the header of a sqlite3 file; it is truncated")
    (page,) = struct.unpack_from(">H", head, 16)
    changes, pages = struct.unpack_from(">II", head, 24)
    (valid_for,) = struct.unpack_from(">I", head, 92)
    size = (65536 if page == 1 else page) * pages
    if unfinished(path):
        return
    if changes == valid_for and path.stat().st_size < size:
        raise BagError(
            f"{name}: has {path.stat().st_size} bytes, its header states {size}; it is truncated, --recover "
            "saves the intact part"
        )

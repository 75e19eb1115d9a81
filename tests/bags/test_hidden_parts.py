"""What is part of an input without being in its first bag: second bags, logs, journals. Nothing is left beside it."""

import io
import shutil
import sqlite3
import struct
import subprocess
import sys
from contextlib import closing

import pytest
from oracles import OFFICE_BAG, OFFICE_DB, OFFICE_MCAP, copy, count_of, pipe_of
from test_recover import recover

from odomcorrupt.bags.open import open_reader
from odomcorrupt.cli import run
from odomcorrupt.errors import BagError

COUNT = 2487
JOURNAL = bytes.fromhex("d9d505f920a163d7")

KILLED = """
import os, sqlite3, sys
connection = sqlite3.connect(sys.argv[1], isolation_level=None)
for statement in sys.argv[2:]:
    connection.execute(statement).fetchall()
os.kill(os.getpid(), 9)
"""


def killed(path, *statements):
    """Execute statements in a process that is then killed."""
    subprocess.run([sys.executable, "-c", KILLED, path, *statements], check=False, capture_output=True)
    return path


def interrupted(path):
    """Return a database whose recorder was killed while it overwrote all messages: a hot rollback journal."""
    shutil.copyfile(OFFICE_DB, path)
    killed(
        path, "PRAGMA journal_mode = DELETE", "PRAGMA cache_size = 5", "BEGIN",
        "UPDATE messages SET data = zeroblob(length(data))",
    )  # fmt: skip
    assert path.with_name(f"{path.name}-journal").stat().st_size > 1000
    return path


def logged(path):
    """Return a database whose latest message is in its log."""
    shutil.copyfile(OFFICE_DB, path)
    add = "INSERT INTO messages (topic_id, timestamp, data) SELECT topic_id, timestamp + 1, data FROM messages LIMIT 1"
    killed(path, "PRAGMA journal_mode = WAL", "PRAGMA wal_autocheckpoint = 0", add)
    assert path.with_name(f"{path.name}-wal").stat().st_size
    return path


def messages(path):
    """Return (topic, time, data) of all messages, as sqlite3 reads them from a copy of the files."""
    with closing(sqlite3.connect(path)) as connection:
        return connection.execute("SELECT topic_id, timestamp, data FROM messages ORDER BY id").fetchall()


def seen(folder):
    return {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in folder.rglob("*") if path.is_file()}


@pytest.fixture(params=["journal", "log", "log without its index", "link to a log"])
def unfinished(request, tmp_path):
    """Return a database with files beside it, and the messages in it."""
    folder = tmp_path / "in"
    folder.mkdir()
    path = interrupted(folder / "in.db3") if request.param == "journal" else logged(folder / "in.db3")
    if "without" in request.param:
        (folder / "in.db3-shm").unlink()
    shutil.copytree(folder, tmp_path / "like")
    rows = messages(tmp_path / "like" / "in.db3")
    assert len(rows) in (COUNT, COUNT + 1)
    if "link" in request.param:
        (tmp_path / "linked").mkdir()
        path = tmp_path / "linked" / "in.db3"
        path.symlink_to(folder / "in.db3")
    return path, rows


@pytest.mark.parametrize("recovering", [False, True])
def test_a_database_is_what_sqlite3_makes_of_it_and_its_folder_stays_as_it_is(unfinished, recovering, tmp_path):
    path, rows = unfinished
    before = seen(path.parent), seen(tmp_path / "in")
    for out in (tmp_path / "out.db3", tmp_path / "out.mcap"):
        assert not (recover if recovering else copy)(path, out) or not recovering
    # a copy in one piece would be of the file alone
    assert run([str(path), str(tmp_path / "same.db3"), "--alpha", "0", "0", "0", "0", "-q"]) == 0
    assert (seen(path.parent), seen(tmp_path / "in")) == before
    assert messages(tmp_path / "out.db3") == rows
    assert messages(tmp_path / "same.db3") == rows
    assert count_of(tmp_path / "out.mcap") == len(rows)


def test_a_folder_of_parts_is_read_with_the_journal_of_one(tmp_path):
    (tmp_path / "in").mkdir()
    interrupted(tmp_path / "in" / "in.db3")
    before = seen(tmp_path / "in")
    copy(tmp_path / "in", tmp_path / "out")
    assert seen(tmp_path / "in") == before
    assert messages(tmp_path / "out" / "in.db3") == messages(OFFICE_DB)


def test_no_journal_names_a_file_to_delete(tmp_path):
    (tmp_path / "in").mkdir()
    path, victim = interrupted(tmp_path / "in" / "in.db3"), tmp_path / "victim"
    victim.write_bytes(b"precious")
    name = str(victim).encode()
    with path.with_name("in.db3-journal").open("ab") as stream:
        stream.write(struct.pack(">I", 262145) + name + struct.pack(">II", len(name), sum(name)) + JOURNAL)
    with pytest.raises(BagError, match="its journal is one of several databases"):
        open_reader(path)
    assert victim.read_bytes() == b"precious"


@pytest.mark.parametrize("table", ["messages", "metadata", "topics"])
@pytest.mark.parametrize("name", ["rowid", "OID", "_rowid_"])
def test_a_column_that_hides_the_row_numbers_is_refused(table, name, tmp_path):
    path = tmp_path / "in.db3"
    shutil.copyfile(OFFICE_DB, path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute(f"ALTER TABLE {table} ADD COLUMN {name} INTEGER")
    for recovering in (False, True):
        with pytest.raises(BagError, match=f"its table {table} has a column of the name of sqlite3's row numbers"):
            open_reader(path, recover=recovering)


@pytest.mark.parametrize("source", [OFFICE_MCAP, OFFICE_BAG, OFFICE_DB], ids=["mcap", "ros1", "sqlite3"])
@pytest.mark.parametrize("rest", ["bag", "byte"])
def test_what_follows_a_bag_is_never_dropped_silently(source, rest, tmp_path, monkeypatch, capsys):
    bag = source.read_bytes()
    path = tmp_path / f"in{source.suffix}"
    path.write_bytes(bag + (bag if rest == "bag" else b"\1"))
    if source is OFFICE_DB and rest == "byte":
        pytest.skip("sqlite3 itself makes files larger than their pages")
    with pytest.raises(BagError):
        copy(path, tmp_path / f"out{source.suffix}")
    assert recover(path, tmp_path / f"saved{source.suffix}")
    assert count_of(tmp_path / f"saved{source.suffix}") == count_of(source) * (
        2 if rest == "bag" and source is not OFFICE_DB else 1
    )
    if source is not OFFICE_DB:
        monkeypatch.setattr("sys.stdin", io.TextIOWrapper(pipe_of(path.read_bytes())))
        assert run(["-", str(tmp_path / "piped.mcap"), "--odom", "/odom", "-q"]) == 1
        assert "goes on behind the end of the bag" in capsys.readouterr().err
        assert not (tmp_path / "piped.mcap").exists()

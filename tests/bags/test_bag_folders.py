"""Folders of ROS 2 bags: YAML is bounded, no file is read twice, one recording is one bag, with what lies beside."""

import io
import os
import shutil
import sqlite3
import struct
import subprocess
import sys
import time
from contextlib import closing

import pytest
from oracles import OFFICE, OFFICE_BAG, OFFICE_DB, OFFICE_MCAP, copy, count_of, pipe_of
from test_recover import recover

from odomcorrupt.bags.block import Definition
from odomcorrupt.bags.open import open_reader
from odomcorrupt.bags.rosbag2 import bounded_yaml, metadata
from odomcorrupt.bags.rosbag2.bounded_yaml import load_yaml
from odomcorrupt.bags.rosbag2.metadata import TopicInfo, generated
from odomcorrupt.cli import run
from odomcorrupt.errors import BagError

DB = OFFICE_DB.name
BOMB = "".join(f"a{k}: &a{k} [{', '.join([f'*a{k - 1}'] * 9) if k else ', '.join(['x'] * 9)}]\n" for k in range(9))
HOSTILE = {
    "deep list": ("a: " + "[" * 400 + "]" * 400, "nested more than"),
    "deep map": ("a: " + "{b: " * 400 + "}" * 400, "nested more than"),
    "deep block": ("".join(" " * k + "a:\n" for k in range(400)), "nested more than"),
    "list as a key": ("? [a, b]\n: 1\n", "a key is a list or a map"),
    "map as a key": ("{{a: 1}: 2}", "a key is a list or a map"), "aliases": (BOMB, "more than 1000 entries"),
    "aliases, merged": (BOMB.replace("[", "{<<: [").replace("]", "]}"), "entries|nested|list or a map|expected"),
    "itself": ("a: &a [*a]", "part of"), "nobody": ("a: *a", "for nothing|undefined"),
    "many keys": ("".join(f"k{k}: 1\n" for k in range(600)), "more than 1000 entries"),
    "a tag": ("a: !!python/object/apply:os.system [true]", "metadata.yaml"),
    "a date": ("a: 2001-99-99", "metadata.yaml|month"), "a number": ("a: " + "9" * 10_000, "metadata.yaml|digits"),
    "a zero byte": ("a: \0", "special characters|unacceptable"),
}  # fmt: skip


@pytest.fixture
def bag(tmp_path):
    shutil.copytree(OFFICE, tmp_path / "bag")
    return tmp_path / "bag"


@pytest.mark.parametrize("name", HOSTILE)
def test_hostile_metadata_is_a_line_at_once(name, bag, monkeypatch):
    monkeypatch.setattr(bounded_yaml, "LARGEST_NODES", 1000)  # the parser needs seconds for as many as are allowed
    text, words = HOSTILE[name]
    (bag / "metadata.yaml").write_text(text)
    begun = time.process_time()
    with pytest.raises(BagError, match=words) as caught:
        open_reader(bag)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 600
    assert time.process_time() - begun < 2.0


@pytest.mark.parametrize("load", [load_yaml, lambda text: load_yaml(text, "rt")])
def test_aliases_and_merges_of_honest_size_are_read(load):
    assert load("a: &a {x: 1}\nb: *a\nc: [*a, *a]\n") == {"a": {"x": 1}, "b": {"x": 1}, "c": [{"x": 1}, {"x": 1}]}
    assert load("a: &a {x: 1}\nb: {<<: *a, y: 2}\n")["b"]["x"] == 1


def test_a_file_that_is_too_large_or_takes_too_long_is_refused(bag, monkeypatch):
    monkeypatch.setattr(bounded_yaml, "LONGEST_S", -1.0)
    metadata._parsed.cache_clear()
    with pytest.raises(BagError, match="takes more than"):
        open_reader(bag)
    (bag / "metadata.yaml").write_text("a: " + "x" * (5 << 20))
    with pytest.raises(BagError, match="more than 4194304 bytes"):
        open_reader(bag)


def test_qos_that_is_no_yaml_stays_a_text():
    for qos in ("- history: keep_last\n  " + "[" * 400, "- history: keep_last\n  x: *y", "{[a]: history: keep"):
        topic = TopicInfo("/a", "cdr", Definition("std_msgs/msg/String", "", b"", {"offered_qos_profiles": qos}))
        assert load_yaml(generated("mcap", [], [topic]))["rosbag2_bagfile_information"]["topics_with_message_count"]


@pytest.mark.parametrize("name", ["metadata.yaml", DB])
@pytest.mark.parametrize("kind", ["pipe", "device", "directory"])
def test_a_pipe_in_place_of_a_file_is_refused_and_not_waited_for(name, kind, bag):
    (bag / name).unlink()
    if kind == "pipe":
        os.mkfifo(bag / name)
    elif kind == "device":
        (bag / name).symlink_to("/dev/zero")
    else:
        (bag / name).mkdir()
    with pytest.raises(BagError, match=r"is (not a regular file|no file|a pipe|a device|a directory)"):
        open_reader(bag)


@pytest.mark.parametrize("way", ["listed", "listed elsewhere", "symlink", "hard link"])
def test_no_file_is_read_twice(way, bag, tmp_path):
    text = (bag / "metadata.yaml").read_text()
    if way.startswith("listed"):
        second = DB if way == "listed" else f"office_ros2/{DB}"
        line = next(line for line in text.splitlines(keepends=True) if line.strip() == f"- {DB}")
        (bag / "metadata.yaml").write_text(text.replace(line, line + line.replace(DB, second), 1))
    else:
        (bag / "metadata.yaml").unlink()
        (bag / DB).rename(bag / "part_0.db3")
        if way == "symlink":
            (bag / "part_1.db3").symlink_to("part_0.db3")
        else:
            (bag / "part_1.db3").hardlink_to(bag / "part_0.db3")
    with pytest.raises(BagError, match="is the same file as"):
        copy(bag, tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(
    ("names", "fine"), [(["a_0", "a_1", "a_2"], True), (["a_9", "a_10", "a_11"], True), (["2024_01_02_3"], True),
    (["office", "mystery"], False), (["a_0", "a_2"], False), (["a_0", "b_1"], False), (["a_1", "a_01"], False),
    (["a_0", ".hidden"], True)]
)  # fmt: skip
def test_a_folder_without_metadata_is_one_bag_only_if_its_names_count(names, fine, tmp_path):
    (tmp_path / "in").mkdir()
    for name in names:
        shutil.copyfile(OFFICE_MCAP, tmp_path / "in" / f"{name}.mcap")
    if fine:
        with open_reader(tmp_path / "in") as reader:
            assert len(reader.parts) == sum(not name.startswith(".") for name in names)
        return
    with pytest.raises(BagError, match="not evidently parts of one recording") as caught:
        open_reader(tmp_path / "in")
    assert all(f"{name}.mcap" in str(caught.value) for name in names)


def test_a_folder_of_one_ros1_bag_is_that_bag(tmp_path):
    (tmp_path / "in").mkdir()
    shutil.copyfile(OFFICE_BAG, tmp_path / "in" / "run.bag")
    copied = [copy(source, tmp_path / name) for source, name in ((OFFICE_BAG, "a.bag"), (tmp_path / "in", "b.bag"))]
    assert copied[0].read_bytes() == copied[1].read_bytes()


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

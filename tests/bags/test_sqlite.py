"""sqlite3 bags: schemas and tables."""

import re
import shutil
import sqlite3
from contextlib import closing

import pytest
from oracles import OFFICE_DB, copy, count_of
from test_recover import recover, rows_of

from odomcorrupt.bags.open import open_reader
from odomcorrupt.bags.rosbag2 import database
from odomcorrupt.errors import BagError

ENDLESS = "WITH RECURSIVE c(n) AS (SELECT 1 UNION ALL SELECT n + 1 FROM c) SELECT n FROM c"
DELETES = "CREATE TRIGGER t AFTER UPDATE ON messages BEGIN DELETE FROM messages WHERE topic_id = 3; END"
SWALLOWS = "CREATE TRIGGER t BEFORE UPDATE ON messages BEGIN SELECT RAISE(IGNORE); END"
REPLACES = "CREATE TRIGGER t AFTER UPDATE ON messages BEGIN UPDATE messages SET data = x'00' WHERE topic_id = 3; END"
INSERTS = (
    "CREATE TRIGGER t AFTER UPDATE ON messages BEGIN "
    "INSERT INTO messages (topic_id, timestamp, data) VALUES (3, 1, x'00'); END"
)
EXPLODES = f"CREATE TRIGGER t AFTER UPDATE ON messages BEGIN INSERT INTO topics (name) {ENDLESS}; END"
TRIGGERS = [DELETES, SWALLOWS, REPLACES, INSERTS, EXPLODES]


def changed(tmp_path, *statements, values=()):
    """Return a copy of the office's file in which statements were executed, all with these values."""
    path = tmp_path / "in.db3"
    shutil.copyfile(OFFICE_DB, path)
    with closing(sqlite3.connect(path)) as connection, connection:
        for statement in statements:
            connection.execute(statement, values if "?" in statement else ())
    return path


def remade(columns, rule=""):
    """Return statements that recreate the table of messages."""
    return (
        f"CREATE TABLE other ({columns}{rule})",
        "INSERT INTO other SELECT * FROM messages",
        "DROP TABLE messages",
        "ALTER TABLE other RENAME TO messages",
    )


PLAIN = "id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL"
SCHEMAS = {
    "trigger": [DELETES],
    "trigger on insertion": [DELETES.replace("UPDATE ON", "INSERT ON")],
    "temporary view": [f"CREATE VIEW v AS {ENDLESS}"],
    "view of definitions": [
        "DROP TABLE IF EXISTS message_definitions",
        f"CREATE VIEW message_definitions AS {ENDLESS}",
    ],
    "check": remade(PLAIN, ", CHECK (length(hex(data)) > 0)"),
    "conflict": remade(PLAIN, ", UNIQUE (timestamp) ON CONFLICT REPLACE"),
    "generated": [*remade(PLAIN), "ALTER TABLE messages ADD COLUMN more AS (hex(data))"],
    "index that computes": ["CREATE INDEX i ON messages (hex(data))"],
    "index of some rows": ["CREATE INDEX i ON messages (topic_id) WHERE hex(data) > 'a'"],
    "virtual table": ["CREATE VIRTUAL TABLE f USING fts5(x)"],
}


@pytest.mark.parametrize("recovering", [False, True])
@pytest.mark.parametrize("name", SCHEMAS)
def test_a_schema_that_acts_by_itself_is_refused_in_a_line(name, recovering, tmp_path):
    path = changed(tmp_path, *SCHEMAS[name])
    with pytest.raises(BagError, match="no recorder makes that") as caught:
        open_reader(path, recover=recovering)
    assert "\n" not in str(caught.value)


def test_plain_indexes_and_other_tables_do_no_harm(tmp_path):
    path = changed(tmp_path, "CREATE INDEX i ON messages (topic_id, timestamp)", "CREATE TABLE notes (x CHECK (x > 0))")
    copy(path, tmp_path / "out.db3")


@pytest.mark.parametrize("trigger", TRIGGERS[:4])
def test_what_a_trigger_does_is_counted_and_nothing_is_kept(trigger, tmp_path, monkeypatch):
    path = changed(tmp_path, trigger)
    monkeypatch.setattr(database, "require_plain", lambda *_: None)
    monkeypatch.setattr(database, "_SWITCHES", {})

    def change(reader, _writer, block):
        (odometry,) = (one.id for one in reader.channels.values() if one.topic == "/odom")
        for row in block.table[block.table["channel"] == odometry][:1]:
            block.data[row["offset"] + row["length"] - 1] ^= 1

    with pytest.raises(BagError, match="rows were to change"):
        copy(path, tmp_path / "out.db3", change)
    assert [one.name for one in tmp_path.iterdir()] == ["in.db3"]


BROKEN = b"float64 x\n" * 500 + b"\xff"


@pytest.mark.parametrize("recovering", [False, True])
@pytest.mark.parametrize(
    "change", ["ALTER TABLE messages RENAME COLUMN topic_id TO topic_ie",
    "ALTER TABLE messages RENAME COLUMN data TO date", "ALTER TABLE topics RENAME COLUMN type TO tipe",
    "ALTER TABLE messages RENAME TO mesages"]
)  # fmt: skip
def test_a_name_that_is_damaged_is_reported_in_a_line_that_advises_nothing(change, recovering, tmp_path):
    path = changed(tmp_path, change)
    with pytest.raises(BagError) as caught:
        open_reader(path, recover=recovering)
    said = str(caught.value)
    assert said.startswith(f"{path}: is a sqlite3 database without rosbag2's topics and messages")
    assert "--recover" not in said
    assert "\n" not in said


@pytest.mark.parametrize("directory", [False, True])
@pytest.mark.parametrize("change", ["topic_id = -1", "data = 'text'", "timestamp = 'noon'"])
def test_a_message_without_a_topic_data_or_time_is_lost_alone(change, directory, tmp_path):
    source = changed(tmp_path, f"UPDATE messages SET {change} WHERE rowid = 14")  # noqa: S608 - ours
    if directory:
        shutil.copytree(OFFICE_DB.parent, tmp_path / "in")
        source.replace(tmp_path / "in" / OFFICE_DB.name)
        source = tmp_path / "in"
    with pytest.raises(BagError, match="message 14 has no data, no time or no topic"):
        copy(source, tmp_path / f"no{source.suffix}")
    out = tmp_path / f"out{source.suffix}"
    (loss,) = recover(source, out)
    assert "message 14 has no data, no time or no topic; the bag is damaged" in loss
    assert count_of(copy(out, tmp_path / f"again{source.suffix}")) == count_of(OFFICE_DB) - 1


@pytest.mark.parametrize("recovering", [False, True])
def test_text_that_is_none_is_reported_in_a_line(recovering, tmp_path):
    path = changed(tmp_path, "UPDATE topics SET type = CAST(? AS TEXT)", values=(BROKEN,))
    with pytest.raises(BagError, match="sqlite3 reports Could not decode to UTF-8") as caught:
        open_reader(path, recover=recovering)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


def test_a_definition_in_another_encoding_comes_through(tmp_path):
    statement = "UPDATE message_definitions SET encoded_message_definition = CAST(? AS TEXT)"
    path = changed(tmp_path, statement, values=(BROKEN,))
    copy(path, tmp_path / "out.db3")
    with closing(sqlite3.connect(tmp_path / "out.db3")) as connection:
        query = "SELECT CAST(encoded_message_definition AS BLOB) FROM message_definitions"
        assert {text for (text,) in connection.execute(query)} == {BROKEN}


def _with_bad_page(path, table, which):
    """Copy the bag with one of a table's leaf pages overwritten."""
    data = bytearray(OFFICE_DB.read_bytes())
    with closing(sqlite3.connect(OFFICE_DB)) as connection:
        (root,) = connection.execute("SELECT rootpage FROM sqlite_master WHERE name = ?", (table,)).fetchone()
    page = (root - 1) * 4096
    assert data[page] == 5, "an interior page"
    place = int.from_bytes(data[page + 12 + 2 * which : page + 14 + 2 * which])
    leaf = int.from_bytes(data[page + place : page + place + 4])
    data[(leaf - 1) * 4096 : leaf * 4096] = b"\xff" * 4096
    path.write_bytes(data)


@pytest.mark.parametrize("which", [0, 1, 5])
def test_any_page_of_messages_costs_its_own_rows_alone(which, tmp_path):
    _with_bad_page(tmp_path / "in.db3", "messages", which)
    assert any("messages from" in loss for loss in recover(tmp_path / "in.db3", tmp_path / "out.db3"))
    assert 0.9 * count_of(OFFICE_DB) < count_of(tmp_path / "out.db3") < count_of(OFFICE_DB)


def test_definitions_that_cannot_be_read_cost_no_message(tmp_path):
    _with_bad_page(tmp_path / "in.db3", "message_definitions", 0)
    (loss,) = recover(tmp_path / "in.db3", tmp_path / "out.db3")
    assert "some definitions of message types are lost" in loss
    assert count_of(tmp_path / "out.db3") == count_of(OFFICE_DB)


def test_messages_of_a_topic_that_is_gone_are_lost_in_one_line(tmp_path):
    changed(tmp_path, "DELETE FROM topics WHERE name = '/imu'")
    (loss,) = recover(tmp_path / "in.db3", tmp_path / "out.db3")
    assert re.fullmatch(
        r".*message \d+ has no data, no time or no topic; the bag is damaged; the same applies to \d+ more", loss
    )
    copy(tmp_path / "out.db3", tmp_path / "again.db3")


@pytest.mark.parametrize("row", [-(1 << 63), -1, (1 << 63) - 1])
def test_any_number_of_a_row_is_read(row, tmp_path):
    changed(tmp_path, "UPDATE messages SET id = ? WHERE id = 20", values=(row,))
    copy(tmp_path / "in.db3", tmp_path / "out.db3")
    assert rows_of(tmp_path / "out.db3") == rows_of(tmp_path / "in.db3")


@pytest.mark.parametrize("number", [-1, 1 << 32, 2])
@pytest.mark.parametrize("recovering", [False, True])
def test_ids_of_topics_that_no_recorder_gives_are_refused(number, recovering, tmp_path):
    changed(
        tmp_path,
        "CREATE TABLE other AS SELECT * FROM topics",  # without a primary key
        "DROP TABLE topics", "ALTER TABLE other RENAME TO topics", "UPDATE topics SET id = ? WHERE id = 1",
        values=(number,),
    )  # fmt: skip
    with pytest.raises(BagError, match=f"has the id {number}, which is negative, too large or already used"):
        open_reader(tmp_path / "in.db3", recover=recovering)


def test_metadata_that_is_none_is_reported_in_a_line(tmp_path):
    shutil.copytree(OFFICE_DB.parent, tmp_path / "in")
    metadata = tmp_path / "in" / "metadata.yaml"
    text = metadata.read_text()
    # a key twice, which the parser answers with all that stands there
    metadata.write_text(text + text.partition("\n")[2])
    with pytest.raises(BagError, match="found duplicate key") as caught:
        open_reader(tmp_path / "in")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


def test_a_file_of_more_than_two_gigabytes_is_read(tmp_path):
    path = tmp_path / "in.db3"
    shutil.copyfile(OFFICE_DB, path)
    with path.open("r+b") as stream:
        # a hole: sqlite3 reads as many pages as the header tells of
        stream.truncate((1 << 31) + (1 << 20))
    assert count_of(path) == count_of(OFFICE_DB)

"""sqlite3 files whose schema acts by itself: what it would do is refused, or seen by counting."""

import shutil
import sqlite3
from contextlib import closing

import pytest
from oracles import FIXTURES, copy

from odomcorrupt.bags.open import open_reader
from odomcorrupt.bags.rosbag2 import database
from odomcorrupt.errors import BagError

OFFICE_DB = FIXTURES / "office_ros2" / "office_ros2.db3"

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


def changed(tmp_path, *statements):
    path = tmp_path / "in.db3"
    shutil.copyfile(OFFICE_DB, path)
    with closing(sqlite3.connect(path)) as connection, connection:
        for statement in statements:
            connection.execute(statement)
    return path


def remade(columns, rule=""):
    """Return statements that make the table of messages anew."""
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

"""sqlite3 files whose tables are not a rosbag2's."""

import shutil
import sqlite3
from contextlib import closing

import pytest
from oracles import FIXTURES

from odomcorrupt.bags.open import open_reader
from odomcorrupt.errors import BagError

BROKEN = b"float64 x\n" * 500 + b"\xff"
OFFICE_DB = FIXTURES / "office_ros2" / "office_ros2.db3"


@pytest.mark.parametrize("recover", [False, True])
@pytest.mark.parametrize(
    "change",
    [
        "ALTER TABLE messages RENAME COLUMN topic_id TO topic_ie",
        "ALTER TABLE messages RENAME COLUMN data TO date",
        "ALTER TABLE topics RENAME COLUMN type TO tipe",
        "ALTER TABLE messages RENAME TO mesages",
    ],
)
def test_a_name_that_is_damaged_is_told_in_a_line_that_advises_nothing(change, recover, tmp_path):
    path = tmp_path / "in.db3"
    shutil.copyfile(OFFICE_DB, path)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(change)
    with pytest.raises(BagError) as caught:
        open_reader(path, recover=recover)
    said = str(caught.value)
    assert said.startswith(f"{path}: is a sqlite3 database without rosbag2's topics and messages")
    assert "--recover" not in said
    assert "\n" not in said


@pytest.mark.parametrize("recover", [False, True])
def test_text_that_is_none_is_told_in_a_line(recover, tmp_path):
    path = tmp_path / "in.db3"
    shutil.copyfile(OFFICE_DB, path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE message_definitions SET encoded_message_definition = CAST(? AS TEXT)", (BROKEN,))
    with pytest.raises(BagError, match="sqlite3 says Could not decode to UTF-8") as caught:
        open_reader(path, recover=recover)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


def test_metadata_that_is_none_is_told_in_a_line(tmp_path):
    shutil.copytree(OFFICE_DB.parent, tmp_path / "in")
    metadata = tmp_path / "in" / "metadata.yaml"
    text = metadata.read_text()
    # a key twice, which the parser answers with all that stands there
    metadata.write_text(text + text.partition("\n")[2])
    with pytest.raises(BagError, match="found duplicate key") as caught:
        open_reader(tmp_path / "in")
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500

"""sqlite3 files whose tables are not a rosbag2's."""

import shutil
import sqlite3
from contextlib import closing

import pytest
from oracles import FIXTURES, copy
from test_recover import recover

from odomcorrupt.bags.open import open_reader
from odomcorrupt.errors import BagError

BROKEN = b"float64 x\n" * 500 + b"\xff"
OFFICE_DB = FIXTURES / "office_ros2" / "office_ros2.db3"


@pytest.mark.parametrize("recovering", [False, True])
@pytest.mark.parametrize(
    "change",
    [
        "ALTER TABLE messages RENAME COLUMN topic_id TO topic_ie",
        "ALTER TABLE messages RENAME COLUMN data TO date",
        "ALTER TABLE topics RENAME COLUMN type TO tipe",
        "ALTER TABLE messages RENAME TO mesages",
    ],
)
def test_a_name_that_is_damaged_is_reported_in_a_line_that_advises_nothing(change, recovering, tmp_path):
    path = tmp_path / "in.db3"
    shutil.copyfile(OFFICE_DB, path)
    with closing(sqlite3.connect(path)) as connection:
        connection.execute(change)
    with pytest.raises(BagError) as caught:
        open_reader(path, recover=recovering)
    said = str(caught.value)
    assert said.startswith(f"{path}: is a sqlite3 database without rosbag2's topics and messages")
    assert "--recover" not in said
    assert "\n" not in said


@pytest.mark.parametrize("directory", [False, True])
@pytest.mark.parametrize("change", ["topic_id = -1", "data = 'text'", "timestamp = 'noon'"])
def test_a_message_without_a_topic_data_or_time_is_lost_alone(change, directory, tmp_path):
    source = tmp_path / ("in" if directory else "in.db3")
    if directory:
        shutil.copytree(OFFICE_DB.parent, source)
    else:
        shutil.copyfile(OFFICE_DB, source)
    with closing(sqlite3.connect(source / OFFICE_DB.name if directory else source)) as connection, connection:
        connection.execute(f"UPDATE messages SET {change} WHERE rowid = 14")  # noqa: S608 - ours
    with pytest.raises(BagError, match="message 14 has no data, no time or no topic"):
        copy(source, tmp_path / f"no{source.suffix}")
    out = tmp_path / f"out{source.suffix}"
    (loss,) = recover(source, out)
    assert "message 14 has no data, no time or no topic; the bag is damaged" in loss
    again = tmp_path / f"again{source.suffix}"
    copy(out, again)
    with open_reader(again) as reader, open_reader(OFFICE_DB) as whole:
        saved, everything = (sum(len(block.table) for block in one.blocks()) for one in (reader, whole))
    assert saved == everything - 1


@pytest.mark.parametrize("recovering", [False, True])
def test_text_that_is_none_is_reported_in_a_line(recovering, tmp_path):
    path = tmp_path / "in.db3"
    shutil.copyfile(OFFICE_DB, path)
    with closing(sqlite3.connect(path)) as connection, connection:
        connection.execute("UPDATE message_definitions SET encoded_message_definition = CAST(? AS TEXT)", (BROKEN,))
    with pytest.raises(BagError, match="sqlite3 says Could not decode to UTF-8") as caught:
        open_reader(path, recover=recovering)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500


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
    with open_reader(path) as reader, open_reader(OFFICE_DB) as whole:
        found, everything = (sum(len(block.table) for block in one.blocks()) for one in (reader, whole))
    assert found == everything

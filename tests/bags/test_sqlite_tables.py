"""sqlite3 files whose tables are not a rosbag2's."""

import shutil
import sqlite3
from contextlib import closing

import pytest
from oracles import FIXTURES

from odomcorrupt.bags.open import open_reader
from odomcorrupt.errors import BagError

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

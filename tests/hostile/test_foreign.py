"""Other people's readers see in our outputs what was written; `foreign.py` prints the whole table."""

import foreign
import pytest
from foreign import READERS, Output, asked, missing, opens, ours


@pytest.mark.slow
def test_every_reader_that_is_installed_opens_every_output_it_has_a_format_for():
    assert foreign.main() == 0


@pytest.mark.parametrize(
    ("source", "name", "kind", "reader"),
    [
        ("mcap lz4", "out.mcap", "mcap", "mcap"),
        ("ros1 bz2", "out.bag", "ros1", "evo"),
        ("ros1 lz4", "out.bag", "ros1", "@foxglove/rosbag"),
        ("ros1 none", "out.bag", "ros1", "Debian rosbag"),
        ("sqlite3 file", "out.db3", "sqlite3", "rosbags"),
        ("sqlite3 file", "out.db3", "sqlite3", "sqlite3 integrity"),
    ],
)
def test_a_reader_sees_what_was_written(source, name, kind, reader, bags, tmp_path):
    (one,) = (each for each in READERS if each.name == reader)
    if said := missing(one):
        pytest.skip(f"{reader}: {said}")
    ours(str(bags[source].path), str(tmp_path / name), "--seed", "7")
    output = Output(source, tmp_path / name, kind)
    assert opens(one, output)
    assert asked(one, output) == ""

"""ROS 2 bags in and out: sqlite3 and MCAP, whole and split, judged by sqlite and the rosbags library."""

import shutil
import sqlite3
from contextlib import closing
from functools import cache

import numpy as np
import pytest
from oracles import (
    OFFICE,
    OFFICE_DB,
    OFFICE_MCAP,
    adding,
    copy,
    damaged_copies_fail,
    info_of,
    mcap_extras,
    mcap_messages,
    require_shifted,
    rewritten,
    shift,
)
from rosbags.rosbag2 import Reader, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2LibraryWriter

from odomcorrupt.bags.messages import READABLE
from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.errors import BagError
from recordings import RECORDINGS

DIRECTORIES = [path.parent for path in sorted(RECORDINGS.rglob("metadata.yaml"))]


def dump(path):
    with closing(sqlite3.connect(f"file:{path}?immutable=1", uri=True)) as connection:
        return list(connection.iterdump())


def ros2_messages(path):
    """Return the messages of a ROS 2 bag as the rosbags library reads them."""
    with Reader(path) as reader:
        return [
            (one.topic, one.msgtype, str(one.ext.offered_qos_profiles), time_ns, bytes(data))
            for one, time_ns, data in reader.messages()
        ]


def split(target, storage, parts):
    """Write the office drive as a bag of several files whose topics are numbered differently."""
    target.mkdir()
    for index in range(parts):
        one = target.parent / f"{target.name}_{index}"
        rewritten(
            Reader(OFFICE),
            Ros2LibraryWriter(one, version=8, storage_plugin=storage),
            order=lambda known, index=index: sorted(
                (one for one in known if index == 0 or one.topic != "/tf_static"),
                key=lambda one: one.topic, reverse=index % 2 == 1,
            ),
            kept=lambda number, index=index: number * parts // 2487 == index,
        )  # fmt: skip
        (name,) = (path for path in one.iterdir() if path.suffix != ".yaml")
        shutil.move(name, target / name.name)
    return target


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Return a function that gives the office drive as a bag of a storage and of so many files, made once."""

    @cache
    def make(storage, parts):
        return split(tmp_path_factory.mktemp("made") / "in", storage, parts)

    return make


@pytest.fixture(params=["whole sqlite3", "split sqlite3", "whole mcap", "split mcap", "without metadata", "file"])
def bag(request, tmp_path, made):
    kind = request.param
    if kind == "whole sqlite3":
        return OFFICE
    if kind == "file":
        return OFFICE_DB
    if kind.startswith("split"):
        copy(made(getattr(StoragePlugin, kind.split()[1].upper()), 3), tmp_path / "with metadata")
        return tmp_path / "with metadata"
    if kind == "whole mcap":
        return shutil.copytree(made(StoragePlugin.MCAP, 1), tmp_path / "in")
    (tmp_path / "in").mkdir()
    shutil.copy(OFFICE_DB, tmp_path / "in")
    return tmp_path / "in"


def test_nothing_patched_keeps_every_message_topic_and_qos(bag, tmp_path):
    out = copy(bag, tmp_path / "out")
    assert ros2_messages(out) == ros2_messages(OFFICE)
    before = OFFICE if bag.is_file() else bag
    for path in before.iterdir():
        if path.suffix == ".db3":
            assert dump(out / path.name) == dump(path)
        elif path.suffix == ".yaml" and bag.is_dir():
            assert (out / path.name).read_text() == path.read_text()
        elif path.suffix == ".mcap":
            assert mcap_messages(out / path.name) == mcap_messages(path)
            assert mcap_extras(out / path.name)[1:] == mcap_extras(path)[1:]


def test_metadata_made_for_a_bag_without_says_what_the_library_counts(made, tmp_path):
    for storage in StoragePlugin:
        info = info_of(copy(made(storage, 3), tmp_path / f"out {storage.name}"))
        known = info_of(OFFICE)
        assert info["storage_identifier"] == storage.name.lower()
        for key in ("message_count", "starting_time", "duration"):
            assert info[key] == known[key]
        counts = {one["topic_metadata"]["name"]: one["message_count"] for one in info["topics_with_message_count"]}
        assert counts == {
            one["topic_metadata"]["name"]: one["message_count"] for one in known["topics_with_message_count"]
        }
        assert sum(file["message_count"] for file in info["files"]) == info["message_count"]
        assert [file["path"] for file in info["files"]] == info["relative_file_paths"]


@pytest.mark.parametrize("only_wanted", [False, True])
def test_patched_numbers_are_what_another_decoder_reads(bag, tmp_path, only_wanted):
    out = tmp_path / "out"
    with open_reader(bag) as reader, open_writer(out, reader) as writer:
        wanted = {channel.id for channel in reader.channels.values() if channel.msgtype in READABLE}
        for block in reader.blocks(wanted if only_wanted and writer.keeps_rest else None):
            shift(reader, writer, block)
            writer.write(block)
    require_shifted(ros2_messages(OFFICE), ros2_messages(out))


def test_what_is_not_asked_of_a_database_is_reported_but_not_read():
    with open_reader(OFFICE) as reader:
        wanted = {channel.id for channel in reader.channels.values() if channel.topic == "/odom"}
        every = np.concatenate([block.table for block in reader.blocks()])
        some = np.concatenate([block.table for block in reader.blocks(wanted)])
        read = sum(block.data.size for block in reader.blocks(wanted))
    own = np.isin(every["channel"], list(wanted))
    assert np.array_equal(every[["channel", "log_ns"]], some[["channel", "log_ns"]])
    assert np.array_equal(some["length"], np.where(own, every["length"], 0))
    assert read == every["length"][own].sum()


def test_added_messages_and_topics_are_there_and_counted(bag, tmp_path):
    data = b"\0\1\0\0added"
    out = copy(bag, tmp_path / "out", adding("/odom", "/odom_truth", data))
    seen = ros2_messages(out)
    extra = [one for one in seen if one[4] == data]
    assert {one[0] for one in extra} == {"/odom_truth", "/pose", "/odom"}
    odom = next(one for one in seen if one[0] == "/odom")
    truth = next(one for one in extra if one[0] == "/odom_truth")
    assert truth[1:3] == odom[1:3]
    assert [one for one in seen if one not in extra] == ros2_messages(OFFICE)
    info = info_of(out)
    assert info["message_count"] == len(seen) == sum(file["message_count"] for file in info["files"])
    counts = {one["topic_metadata"]["name"]: one["message_count"] for one in info["topics_with_message_count"]}
    assert counts["/odom_truth"] == counts["/pose"] == counts["/odom"] - 800 > 0


def test_provenance_is_custom_data_and_stays_readable(bag, tmp_path):
    with open_reader(bag) as reader, open_writer(tmp_path / "out", reader) as writer:
        writer.provenance("odomcorrupt", {"seed": "7", "model": "[noise]\nlaw = 'diffusion'\n"})
        for block in reader.blocks():
            writer.write(block)
    assert info_of(tmp_path / "out")["custom_data"] == {
        "odomcorrupt.seed": "7",
        "odomcorrupt.model": "[noise]\nlaw = 'diffusion'\n",
    }
    assert ros2_messages(tmp_path / "out") == ros2_messages(OFFICE)
    for path in (tmp_path / "out").glob("*.mcap"):
        extras = dict(mcap_extras(path)[2])
        assert "odomcorrupt" not in extras or extras["odomcorrupt"]["seed"] == "7"


def test_any_ros2_bag_becomes_one_mcap(bag, tmp_path):
    out = copy(bag, tmp_path / "out.mcap")
    seen = [(one.topic, one.type[0], one.times[0], one.data) for one in mcap_messages(out)]
    assert seen == [(one[0], one[1], one[3], one[4]) for one in ros2_messages(OFFICE)]
    with open_reader(OFFICE_MCAP) as reader:
        texts = {channel.msgtype: reader.definition(channel).text for channel in reader.channels.values()}
    assert {(one.type[0], one.type[2]) for one in mcap_messages(out)} == set(texts.items())


def test_a_split_mcap_that_becomes_one_keeps_publish_times_and_sequences(tmp_path):
    (tmp_path / "in").mkdir()
    for name in ("a_0.mcap", "a_1.mcap"):
        shutil.copy(OFFICE_MCAP, tmp_path / "in" / name)
    out = copy(tmp_path / "in", tmp_path / "out.mcap")
    assert mcap_messages(out) == mcap_messages(OFFICE_MCAP) * 2
    assert len(mcap_extras(out)[1]) == 2


def test_a_file_becomes_a_file_when_its_name_says_so(tmp_path):
    for source in (OFFICE, OFFICE_DB):
        out = copy(source, tmp_path / f"{source.name}.out.db3", shift)
        assert out.is_file()
        again = copy(out, tmp_path / f"{source.stem} of {len(source.suffix)}")
        require_shifted(ros2_messages(OFFICE), ros2_messages(again))


def test_a_recording_with_a_live_log_is_read_whole(tmp_path):
    live = tmp_path / "in" / "live.db3"
    live.parent.mkdir()
    shutil.copy(OFFICE_DB, live)
    with closing(sqlite3.connect(live, isolation_level=None)) as recorder:
        recorder.execute("PRAGMA journal_mode = WAL")
        recorder.execute("PRAGMA wal_autocheckpoint = 0")
        recorder.execute(
            "INSERT INTO messages (topic_id, timestamp, data) VALUES (1, 1700000099000000000, x'00010000')"
        )
        assert live.with_name("live.db3-wal").stat().st_size
        out = copy(live.parent, tmp_path / "out")
        assert sorted(path.name for path in out.iterdir()) == ["live.db3", "metadata.yaml"]
        assert len(ros2_messages(out)) == 2488
        assert info_of(out)["message_count"] == 2488
        # As a recorder that was killed leaves it: the log, without the file that says who reads it.
        killed = tmp_path / "killed"
        killed.mkdir()
        for name in ("live.db3", "live.db3-wal"):
            shutil.copy(live.with_name(name), killed)
    assert len(ros2_messages(copy(killed, tmp_path / "saved"))) == 2488


def test_all_versions_of_the_tables_are_read(tmp_path):
    old = tmp_path / "old.db3"
    shutil.copy(OFFICE_DB, old)
    with closing(sqlite3.connect(old, isolation_level=None)) as connection:
        for statement in (
            *(f"DROP TABLE {name}" for name in ("schema", "metadata", "message_definitions")),
            *(f"ALTER TABLE topics DROP COLUMN {name}" for name in ("type_description_hash", "offered_qos_profiles")),
        ):
            connection.execute(statement)
    out = copy(old, tmp_path / "out.db3", shift)
    assert len(dump(out)) == len(dump(old))
    # Common types get their definitions in an MCAP, without which nobody reads it.
    texts = {one.type[0]: one.type[2] for one in mcap_messages(copy(old, tmp_path / "out.mcap"))}
    assert b"geometry_msgs/TwistWithCovariance twist" in texts["nav_msgs/msg/Odometry"]
    assert texts["office_msgs/msg/Door"] == b""


@pytest.mark.parametrize(
    ("text", "words"), [("", "not a rosbag2 metadata.yaml"), ("a: [", "cannot be read"),
    ("rosbag2_bagfile_information:\n  relative_file_paths: [gone.db3]\n", "gone.db3"),
    ("rosbag2_bagfile_information:\n  relative_file_paths: []\n", "no file"), (None, "without a bag")]
)  # fmt: skip
def test_a_bad_metadata_file_is_an_error_that_names_it(tmp_path, text, words):
    (tmp_path / "in").mkdir()
    if text is not None:
        (tmp_path / "in" / "metadata.yaml").write_text(text)
    with pytest.raises(BagError, match=words):
        open_reader(tmp_path / "in")


def test_a_file_cut_anywhere_is_an_error_and_leaves_nothing(tmp_path):
    size = OFFICE_DB.stat().st_size
    offsets = [1, 15, 16, 99, 100, *np.linspace(101, size - 1, 40).astype(int).tolist(), 4096, 8192, size - 4096]
    assert damaged_copies_fail(OFFICE_DB, tmp_path, offsets, ".db3") == []


def test_only_a_bag_is_ever_replaced_by_a_bag(tmp_path):
    out = tmp_path / "out"
    copy(OFFICE, out, shift)
    with open_reader(OFFICE) as reader, pytest.raises(BagError, match="overwrite=True"):
        open_writer(out, reader)
    copy(OFFICE, out, overwrite=True)
    assert ros2_messages(out) == ros2_messages(OFFICE)
    (out / "thesis.tex").write_text("years of work")
    with open_reader(OFFICE) as reader, pytest.raises(BagError, match="contains more"):
        open_writer(out, reader, overwrite=True)
    (tmp_path / "out.mcap").mkdir()
    with open_reader(OFFICE_MCAP) as reader, pytest.raises(BagError, match="is a directory"):
        open_writer(tmp_path / "out.mcap", reader, overwrite=True)
    (tmp_path / "file").touch()
    with open_reader(OFFICE) as reader, pytest.raises(BagError, match="is a file"):
        open_writer(tmp_path / "file", reader, overwrite=True)


def test_any_ros_2_bag_becomes_a_single_sqlite3_file(tmp_path):
    for number, source in enumerate((OFFICE_MCAP, split(tmp_path / "in", StoragePlugin.SQLITE3, 2), OFFICE)):
        found = []
        for path in (source, copy(source, tmp_path / f"{number}.db3")):
            with open_reader(path) as reader:
                rows = [row for block in reader.blocks() for row in block.table.tolist()]
                found.append(sorted((reader.channels[channel].topic, log_ns) for channel, log_ns, _, _ in rows))
        assert found[0] == found[1]


def test_messages_of_ros_1_do_not_become_a_ros_2_bag_as_they_are(tmp_path):
    for name in ("out.db3", "out"):
        with open_reader(OFFICE_MCAP.with_suffix(".bag")) as reader, pytest.raises(BagError, match="ros1 messages"):
            open_writer(tmp_path / name, reader)


@pytest.mark.recordings
@pytest.mark.parametrize("path", DIRECTORIES, ids=lambda path: path.name)
def test_recordings_of_others_go_through(path, tmp_path):
    out = copy(path, tmp_path / "out")
    assert (out / "metadata.yaml").read_bytes() == (path / "metadata.yaml").read_bytes()
    for file in path.glob("*.db3"):
        assert dump(out / file.name) == dump(file)
    mcap = copy(path, tmp_path / "out.mcap")
    assert len(mcap_messages(mcap)) == info_of(path)["message_count"]


@pytest.mark.recordings
def test_recordings_of_others_were_read():
    assert DIRECTORIES

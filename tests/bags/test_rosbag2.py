"""ROS 2 bags in and out: sqlite3 and MCAP, whole, split and compressed, judged by sqlite and the rosbags library."""

import io
import re
import shutil
import sqlite3
from collections import Counter
from contextlib import closing
from functools import cache

import numpy as np
import pytest
import zstandard
from bagged import messages_in
from oracles import (
    OFFICE,
    OFFICE_DB,
    OFFICE_MCAP,
    adding,
    copy,
    count_of,
    damaged_copies_fail,
    info_of,
    mcap_extras,
    mcap_messages,
    require_shifted,
    rewritten,
    shift,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2LibraryWriter
from ruamel.yaml import YAML
from test_recover import recover, rows_of

from odomcorrupt.bags import source as reading
from odomcorrupt.bags.messages import READABLE
from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.bags.rosbag2 import database
from odomcorrupt.bags.source import VARIABLE
from odomcorrupt.cli import run
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
    assert damaged_copies_fail(OFFICE_DB, tmp_path, offsets, ".db3", piped=False) == []


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


MODES = {"file": CompressionMode.FILE, "message": CompressionMode.MESSAGE}
STORAGES = {"sqlite3": StoragePlugin.SQLITE3, "mcap": StoragePlugin.MCAP}
NOISE = ("--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "7", "-q")


def compressed(path, mode, storage, seconds=2):
    """Write the beginning of the office, compressed by the rosbags library; mode None is as it is."""
    writer = Ros2LibraryWriter(path, version=8, storage_plugin=STORAGES[storage])
    if mode is not None:
        writer.set_compression(MODES[mode], CompressionFormat.ZSTD)
    rewritten(Reader(OFFICE), writer, seconds=seconds)
    return path


def rows(path):
    """Return topic, log time and bytes of every message, as the rosbags library reads them."""
    with Reader(path) as reader:
        return sorted((one.topic, log_ns, bytes(data)) for one, log_ns, data in reader.messages())


def ours(path, **options):
    """Return the same as this package reads them."""
    return sorted(messages_in(path, **options))


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("storage", STORAGES)
def test_a_compressed_bag_is_corrupted_as_if_it_were_not_and_stays_compressed(mode, storage, tmp_path):
    plain = compressed(tmp_path / "plain", None, storage)
    packed = compressed(tmp_path / "packed", mode, storage)
    assert ours(packed) == rows(plain)
    for source, target in ((plain, "plain_out"), (packed, "packed_out")):
        assert run([str(source), str(tmp_path / target), *NOISE]) == 0
    assert rows(tmp_path / "packed_out") == rows(tmp_path / "plain_out")
    info, before = info_of(tmp_path / "packed_out"), info_of(packed)
    assert (info["compression_mode"].lower(), info["compression_format"]) == (mode, "zstd")
    assert info["relative_file_paths"] == before["relative_file_paths"]
    assert info["topics_with_message_count"] == before["topics_with_message_count"]
    assert info["custom_data"]["odomcorrupt.seed"] == "7"
    assert sorted(path.name for path in (tmp_path / "packed_out").iterdir()) == sorted(
        path.name for path in packed.iterdir()
    )


@pytest.mark.parametrize("mode", ["file", "message", "none"])
@pytest.mark.parametrize("storage", STORAGES)
def test_compression_and_storage_are_what_is_asked_for(mode, storage, tmp_path):
    source = compressed(tmp_path / "in", "message" if mode == "file" else "file", "mcap", 1)
    words = ["--compression", mode, "--storage", storage]
    assert run([str(source), str(tmp_path / "out"), *words, *NOISE]) == 0
    assert run([str(source), str(tmp_path / "same"), *NOISE]) == 0
    assert rows(tmp_path / "out") == rows(tmp_path / "same")
    info = info_of(tmp_path / "out")
    assert (info["compression_mode"].lower() or "none", info["storage_identifier"]) == (mode, storage)
    (name,) = info["relative_file_paths"]
    assert name.endswith(".zstd") == (mode == "file")
    assert (tmp_path / "out" / name).is_file()


def test_a_split_bag_stays_split(tmp_path):
    for number in range(2):
        compressed(tmp_path / f"part{number}", "message", "mcap", number + 1)
    bag = tmp_path / "bag"
    bag.mkdir()
    info = info_of(tmp_path / "part0")
    info["relative_file_paths"] = ["bag_0.mcap", "bag_1.mcap"]
    for number in range(2):
        (tmp_path / f"part{number}" / f"part{number}.mcap").rename(bag / f"bag_{number}.mcap")
    YAML(typ="safe").dump({"rosbag2_bagfile_information": info}, bag / "metadata.yaml")
    assert run([str(bag), str(tmp_path / "out"), "--keep-truth", "/clean", *NOISE]) == 0
    for number in range(2):
        one = compressed_counts(tmp_path / "out" / f"bag_{number}.mcap")
        assert one["/clean"] == one["/odom"] == compressed_counts(bag / f"bag_{number}.mcap")["/odom"]


def compressed_counts(path):
    """Return the number of messages by topic of an MCAP, which are all compressed."""
    found = mcap_messages(path)
    assert all(one.data.startswith(b"\x28\xb5\x2f\xfd") for one in found)
    return Counter(one.topic for one in found)


@pytest.mark.parametrize("storage", STORAGES)
@pytest.mark.parametrize("named", ["its file", "the directory without metadata.yaml"])
def test_messages_compressed_one_by_one_are_read_without_metadata(storage, named, tmp_path):
    bag = compressed(tmp_path / "in", "message", storage, 1)
    expected = rows(bag)
    (file,) = (one for one in bag.iterdir() if one.name != "metadata.yaml")
    (bag / "metadata.yaml").unlink()
    source = file if named == "its file" else bag
    assert ours(source) == expected
    target = copy(source, tmp_path / f"out{source.suffix}")
    assert ours(target) == expected
    if not source.suffix:
        assert rows(target) == expected
        assert info_of(target)["compression_mode"] == "MESSAGE"


def test_on_a_pipe_messages_compressed_one_by_one_are_refused_with_the_way_out(tmp_path, monkeypatch, capsys):
    (file,) = compressed(tmp_path / "in", "message", "mcap", 1).glob("*.mcap")
    monkeypatch.setattr("sys.stdin", io.TextIOWrapper(io.BytesIO(file.read_bytes())))
    assert run(["-", str(tmp_path / "out.mcap"), "--odom-topic", "/odom", *NOISE]) == 1
    why = "its messages are compressed one by one (zstd), which a pipe does not say beforehand; name the file or its"
    assert capsys.readouterr().err == f"odomcorrupt: /odom: {why} directory\n"
    assert not (tmp_path / "out.mcap").exists()


@pytest.mark.parametrize("mode", MODES)
def test_nothing_is_said_by_metadata_that_is_not_there(mode, tmp_path):
    packed = compressed(tmp_path / "in", mode, "sqlite3", 1)
    expected = rows(packed)
    (packed / "metadata.yaml").unlink()
    assert ours(packed) == expected
    (file,) = packed.iterdir()
    assert ours(file) == expected
    assert run([str(file), str(tmp_path / "out.db3"), *NOISE]) == 0
    assert len(ours(tmp_path / "out.db3")) == len(expected)


def test_a_silent_model_gives_a_file_decompressed(tmp_path):
    packed = compressed(tmp_path / "in", "file", "mcap", 1)
    (file,) = packed.glob("*.zstd")
    assert run([str(file), str(tmp_path / "out.mcap"), "--effect", "wheel_scale:e=0", "-q"]) == 0
    assert ours(tmp_path / "out.mcap") == rows(packed)


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("storage", STORAGES)
def test_what_would_fill_the_disk_is_refused(mode, storage, tmp_path, monkeypatch):
    bag = compressed(tmp_path / "in", mode, storage, 1)
    bomb = tmp_path / "bomb"
    writer = Ros2LibraryWriter(bomb, version=8, storage_plugin=STORAGES[storage])
    writer.set_compression(MODES[mode], CompressionFormat.ZSTD)
    with writer:
        made = writer.add_connection("/zeros", "std_msgs/msg/String", msgdef="string data", rihs01="RIHS01_0")
        writer.write(made, 10**18, bytes(1 << 23))
    monkeypatch.setenv(VARIABLE, "1MB")
    monkeypatch.setattr(reading, "_TIMES", 10)
    with pytest.raises(BagError, match="ODOMCORRUPT_MAX_UNPACKED=1GiB"):
        ours(bomb)
    assert len(ours(bag)) == len(rows(bag))


@pytest.mark.parametrize("storage", STORAGES)
def test_a_truncated_file_is_refused_and_saved_by_recovery(storage, tmp_path):
    bag = compressed(tmp_path / "in", "file", storage, 2)
    expected = rows(bag)
    (file,) = bag.glob("*.zstd")
    # frames of their own, as one that is written to has: what is whole comes out
    whole = zstandard.ZstdDecompressor().decompress(file.read_bytes(), max_output_size=1 << 26)
    pieces = [zstandard.compress(whole[at : at + 20_000]) for at in range(0, len(whole), 20_000)]
    file.write_bytes(b"".join(pieces))
    assert ours(bag) == expected
    file.write_bytes(b"".join(pieces)[:-30])
    with pytest.raises(BagError, match="zstd cannot decompress it: it is truncated; recover=True"):
        open_reader(bag)
    with open_reader(bag, recover=True) as reader:
        found = sum(len(block.table) for block in reader.blocks())
        assert any("truncated" in loss for loss in reader.losses)
    assert 0 < found <= len(expected)


def test_a_damaged_message_is_refused_and_left_out_by_recovery(tmp_path):
    bag = compressed(tmp_path / "in", "message", "mcap", 1)
    expected = rows(bag)
    (file,) = bag.glob("*.mcap")
    data = file.read_bytes()
    at = data.index(b"\x28\xb5\x2f\xfd", len(data) // 2)
    file.write_bytes(data[: at + 4] + b"\xff" * 8 + data[at + 12 :])
    with pytest.raises(BagError, match="zstd cannot decompress it"):
        ours(bag)
    assert len(ours(bag, recover=True)) == len(expected) - 1


def test_no_copy_is_left_behind(tmp_path, monkeypatch):
    bag = compressed(tmp_path / "in", "file", "sqlite3", 1)
    (tmp_path / "room").mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "room"))
    assert run([str(bag), str(tmp_path / "out"), *NOISE]) == 0
    with pytest.raises(BagError):
        open_reader(OFFICE / "metadata.yaml")
    assert list((tmp_path / "room").iterdir()) == []


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

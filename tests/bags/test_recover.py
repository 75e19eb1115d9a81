"""What is whole of a damaged bag is saved, whichever parts are empty, cut, gone or misstated; what is not is said."""

import io
import shutil
import sqlite3
import struct
from collections import Counter
from contextlib import closing
from functools import cache
from itertools import product

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType
from mcap.writer import Writer as McapLibraryWriter
from oracles import (
    OFFICE_BAG,
    OFFICE_DB,
    OFFICE_MCAP,
    by_chunk,
    copy,
    count_of,
    info_of,
    mcap_messages,
    mcap_record_places,
    ros1_messages,
)
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from ruamel.yaml import YAML
from test_ros1 import packed, records

import odomcorrupt as oc
import rosmessages
from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.bags.source import ROS1 as MAGIC
from odomcorrupt.cli import run
from odomcorrupt.errors import BagError
from recordings import RECORDINGS
from rosmessages import STORES, serialised

SEEN = {".mcap": mcap_messages, ".bag": ros1_messages}


def recover(source, target, stdin=None):
    """Save what can be saved; return what is said to be lost."""
    with open_reader(source, stdin, recover=True) as reader, open_writer(target, reader) as writer:
        for block in reader.blocks():
            writer.write(block)
        assert not any("--recover" in loss for loss in reader.losses)
        return list(reader.losses)


@pytest.mark.parametrize("source", [OFFICE_MCAP, OFFICE_BAG])
def test_a_whole_bag_loses_nothing(source, tmp_path):
    assert recover(source, tmp_path / f"out{source.suffix}") == []
    plain = copy(source, tmp_path / f"plain{source.suffix}")
    assert (tmp_path / f"out{source.suffix}").read_bytes() == plain.read_bytes()


@pytest.mark.parametrize("source", [OFFICE_MCAP, OFFICE_BAG])
@pytest.mark.parametrize("through_pipe", [False, True])
def test_a_cut_bag_keeps_its_whole_chunks_and_says_that_it_was_cut(source, through_pipe, tmp_path):
    data = source.read_bytes()
    everything = set(SEEN[source.suffix](source))
    last = 0
    for share in (0.3, 0.6, 0.9):
        cut = tmp_path / f"cut{source.suffix}"
        cut.write_bytes(data[: int(share * len(data))])
        with pytest.raises(BagError):
            copy(cut, tmp_path / f"no{source.suffix}")
        out = tmp_path / f"out{share}{source.suffix}"
        stdin = io.BytesIO(cut.read_bytes()) if through_pipe else None
        losses = recover(None if through_pipe else cut, out, stdin)
        assert len(losses) >= 1
        assert "truncated" in losses[0]
        saved = SEEN[source.suffix](out)
        assert everything.issuperset(saved)
        assert len(saved) > max(last, 0.8 * share * len(everything))
        last = len(saved)


def test_a_damaged_chunk_of_an_mcap_is_left_out_and_the_others_stay(tmp_path):
    data = bytearray(OFFICE_MCAP.read_bytes())
    chunks = [place for place in mcap_record_places(data) if place[0] == 6]
    middle = (chunks[3][1] + chunks[3][2]) // 2
    data[middle] ^= 0xFF
    (tmp_path / "in.mcap").write_bytes(data)
    losses = recover(tmp_path / "in.mcap", tmp_path / "out.mcap")
    assert len(losses) == 1
    assert f"byte {chunks[3][1]}" in losses[0]
    saved, everything = mcap_messages(tmp_path / "out.mcap"), mcap_messages(OFFICE_MCAP)
    assert set(saved) < set(everything)
    assert len(saved) > len(everything) * (1 - 2 / len(chunks))


def test_a_damaged_chunk_of_a_ros1_bag_is_left_out_and_the_others_stay(tmp_path):
    changed = records(OFFICE_BAG.read_bytes())
    place = [n for n, (fields, _, _) in enumerate(changed) if fields["op"][0] == 5][3]
    content = bytearray(changed[place][2])
    content[len(content) // 2] ^= 0xFF
    changed[place] = (*changed[place][:2], bytes(content))
    (tmp_path / "in.bag").write_bytes(b"#ROSBAG V2.0\n" + b"".join(packed(head, data) for _, head, data in changed))
    assert len(recover(tmp_path / "in.bag", tmp_path / "out.bag")) == 1
    saved, everything = ros1_messages(tmp_path / "out.bag"), ros1_messages(OFFICE_BAG)
    assert set(saved) < set(everything)
    assert len(saved) > 0.9 * len(everything)


@pytest.mark.slow
@pytest.mark.parametrize("source", [OFFICE_MCAP, OFFICE_BAG])
def test_any_damage_leaves_a_readable_bag_of_true_messages(source, tmp_path):
    rng = np.random.default_rng(11)
    data = source.read_bytes()
    everything = set(SEEN[source.suffix](source))
    for offset in rng.integers(5000, len(data), 15).tolist():
        damaged = bytearray(data)
        damaged[offset : offset + 20] = rng.integers(0, 256, 20, dtype=np.uint8).tobytes()
        broken = tmp_path / f"in{source.suffix}"
        broken.write_bytes(damaged[: len(data)])
        out = tmp_path / f"out{source.suffix}"
        out.unlink(missing_ok=True)
        losses = recover(broken, out)
        saved = SEEN[source.suffix](out)
        assert everything.issuperset(saved)
        assert losses or len(saved) == len(everything)


@pytest.mark.recordings
def test_the_unindexed_recording_is_read(tmp_path):
    source = RECORDINGS / "bags" / "malformed" / "unindexed.bag"
    losses = recover(source, tmp_path / "out.bag")
    assert len(ros1_messages(tmp_path / "out.bag")) == 608
    assert losses == []


def rows_of(path):
    with closing(sqlite3.connect(f"file:{path}?immutable=1", uri=True)) as connection:
        assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        return set(connection.execute("SELECT id, topic_id, timestamp, data FROM messages"))


@pytest.mark.parametrize("directory", [False, True])
@pytest.mark.parametrize(("harm", "least"), [("cut", 0.55), ("pages", 0.9), ("nothing", 1.0)])
def test_a_damaged_sqlite3_keeps_the_rows_of_its_whole_pages(directory, harm, least, tmp_path):
    data = bytearray(OFFICE_DB.read_bytes())
    if harm == "cut":
        del data[int(0.6 * len(data)) :]
    elif harm == "pages":
        for share in (0.3, 0.5, 0.7):
            at = int(share * len(data)) // 4096 * 4096
            data[at : at + 4096] = b"\xff" * 4096
    source = tmp_path / ("in" if directory else "in.db3")
    if directory:
        shutil.copytree(OFFICE_DB.parent, source)
        (source / OFFICE_DB.name).write_bytes(data)
    else:
        source.write_bytes(data)
    if harm != "nothing":
        with pytest.raises(BagError, match="recover=True saves the intact part"):
            copy(source, tmp_path / f"no{source.suffix}")
    out = tmp_path / f"out{source.suffix}"
    losses = recover(source, out)
    everything, saved = rows_of(OFFICE_DB), rows_of(out / OFFICE_DB.name if directory else out)
    assert saved <= everything
    assert len(saved) >= least * len(everything)
    assert bool(losses) == (harm != "nothing")
    if directory and harm != "nothing":
        assert f"message_count: {len(saved)}\n" in (out / "metadata.yaml").read_text()


def test_a_record_that_lies_about_its_length_costs_itself_alone(tmp_path):
    data = bytearray(OFFICE_MCAP.read_bytes())
    chunks = [place for place in mcap_record_places(data) if place[0] == 6]
    for number, claim in ((2, 2**40), (5, 100)):
        data[chunks[number][1] + 1 : chunks[number][1] + 9] = claim.to_bytes(8, "little")
    (tmp_path / "in.mcap").write_bytes(data)
    losses = recover(tmp_path / "in.mcap", tmp_path / "out.mcap")
    assert any(f"byte {chunks[2][1]}" in loss for loss in losses)
    counts = [len(block.table) for block in by_chunk(OFFICE_MCAP)]
    saved, everything = mcap_messages(tmp_path / "out.mcap"), mcap_messages(OFFICE_MCAP)
    assert set(saved) < set(everything)
    assert len(saved) == len(everything) - counts[2] - counts[5]


@pytest.mark.parametrize("codec", ["none", "lz4", "bz2"])
def test_the_last_chunk_of_a_cut_ros1_bag_keeps_its_whole_messages(codec, tmp_path):
    whole = copy(OFFICE_BAG, tmp_path / "whole.bag", compression=codec)
    data = whole.read_bytes()
    at = data.index(b"compression=", len(data) // 2)
    (tmp_path / "in.bag").write_bytes(data[: at + 60_000])
    losses = recover(tmp_path / "in.bag", tmp_path / "out.bag")
    (tmp_path / "before.bag").write_bytes(data[: at - 4])
    recover(tmp_path / "before.bag", tmp_path / "less.bag")
    saved, less = ros1_messages(tmp_path / "out.bag"), ros1_messages(tmp_path / "less.bag")
    assert set(saved) <= set(ros1_messages(OFFICE_BAG))
    assert "truncated in a chunk" in losses[0]
    # bz2 gives nothing before a block of 900 kB is whole
    assert len(saved) > len(less) or codec == "bz2"


SCHEMA, CHUNK, INDEX, ROS1_CHUNK = 3, 6, 7, 5
CHUNK_HEAD = 9 + 40
RECORD = 9 + 22 + 100
"""Bytes of a message's record in the bag of equal messages."""


def write_equal(path, lengths, *, checksums=True):
    """Write an MCAP of chunks that are not compressed, about ten messages of a hundred bytes each; return its bytes."""
    with path.open("wb") as stream:
        writer = McapLibraryWriter(
            stream, chunk_size=10 * RECORD - 50, compression=CompressionType.NONE, enable_crcs=checksums
        )
        writer.start()
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/text", "cdr", schema)
        for number, length in enumerate(lengths):
            writer.add_message(channel, number, bytes([number]) * length, number)
        writer.finish()
    return path.read_bytes()


def counts_of(path):
    """Return how many messages each chunk holds."""
    return [len(block.table) for block in by_chunk(path)]


def judge(whole, saved, first, count):
    """Hold what was saved against the whole bag: of messages, only those of one chunk are missing."""
    there = set(saved)
    missing = [place for place, message in enumerate(whole) if message not in there]
    assert set(missing) <= set(range(first, first + count))
    assert len(missing) > 0


@pytest.mark.parametrize("checksums", [True, False])
@pytest.mark.parametrize("behind", [0, 40, RECORD])
def test_a_length_that_ends_between_two_messages_of_the_next_chunk_of_an_mcap(behind, checksums, tmp_path):
    data = write_equal(tmp_path / "whole.mcap", [100] * 80, checksums=checksums)
    chunks = [place for place in mcap_record_places(data) if place[0] == CHUNK]
    (_, begin, end), (_, next_begin, _) = chunks[3:5]
    missing = (next_begin + CHUNK_HEAD + 2 * RECORD) - end
    at = begin + CHUNK_HEAD + 2 * RECORD + behind
    (tmp_path / "in.mcap").write_bytes(data[:at] + data[at + missing :])
    assert recover(tmp_path / "in.mcap", tmp_path / "out.mcap")
    counts = counts_of(tmp_path / "whole.mcap")
    judge(mcap_messages(tmp_path / "whole.mcap"), mcap_messages(tmp_path / "out.mcap"), sum(counts[:3]), counts[3])


@pytest.mark.parametrize("behind", [CHUNK, INDEX, SCHEMA])
def test_a_length_that_ends_between_two_records_with_the_next_chunk_in_it(behind, tmp_path):
    data = write_equal(tmp_path / "whole.mcap", [100] * 30 + [5000] + [100] * 20)
    places = mcap_record_places(data)
    chunks = [place for place in places if place[0] == CHUNK]
    large = next(number for number, (_, begin, end) in enumerate(chunks) if end - begin > 5000)
    begin, end = chunks[large][1:]
    claimed = next(place[1] for place in places if place[0] == behind and place[1] > chunks[large + 1][1])
    at = begin + CHUNK_HEAD + 10
    (tmp_path / "in.mcap").write_bytes(data[:at] + data[at + claimed - end :])
    assert len(recover(tmp_path / "in.mcap", tmp_path / "out.mcap")) == 1
    counts = counts_of(tmp_path / "whole.mcap")
    whole, saved = mcap_messages(tmp_path / "whole.mcap"), mcap_messages(tmp_path / "out.mcap")
    judge(whole, saved, sum(counts[:large]), counts[large])


def test_a_chunk_that_claims_more_than_the_rest_of_the_file_and_others_stand_in_it(tmp_path):
    data = write_equal(tmp_path / "whole.mcap", [100] * 80)
    chunks = [place for place in mcap_record_places(data) if place[0] == CHUNK]
    begin, end = chunks[3][1:]
    claimed = len(data)
    lying = bytes([CHUNK]) + struct.pack("<Q", claimed) + data[begin + 9 : begin + 41] + struct.pack("<Q", claimed - 40)
    (tmp_path / "in.mcap").write_bytes(data[:begin] + lying + data[begin + CHUNK_HEAD :])
    losses = recover(tmp_path / "in.mcap", tmp_path / "out.mcap")
    assert f"needs {claimed} bytes" in losses[0]
    judge(mcap_messages(tmp_path / "whole.mcap"), mcap_messages(tmp_path / "out.mcap"), 29, 10)
    assert end < len(data)


@pytest.mark.parametrize("index", [2**40, 300, 7])
def test_an_index_that_lies_about_its_length_costs_no_message(index, tmp_path):
    data = bytearray(write_equal(tmp_path / "whole.mcap", [100] * 80))
    begin = [place for place in mcap_record_places(data) if place[0] == INDEX][3][1]
    data[begin + 1 : begin + 9] = struct.pack("<Q", index)
    (tmp_path / "in.mcap").write_bytes(data)
    assert recover(tmp_path / "in.mcap", tmp_path / "out.mcap")
    assert mcap_messages(tmp_path / "out.mcap") == mcap_messages(tmp_path / "whole.mcap")


@pytest.mark.slow
def test_a_length_that_ends_between_two_messages_of_the_next_chunk_of_a_ros1_bag(tmp_path):
    whole = copy(OFFICE_BAG, tmp_path / "whole.bag", compression="none")
    data = whole.read_bytes()
    places, at = [], len(MAGIC)
    for fields, header, content in records(data):
        size = 8 + len(header) + len(content)
        if fields["op"][0] == ROS1_CHUNK:
            places.append((at, at + 8 + len(header), at + size))
        at += size
    counts = counts_of(whole)
    starts = [block.raw.starts for block in by_chunk(whole)]
    (_, content, end), (_, next_content, _) = places[3:5]
    missing = next_content + int(starts[4][5]) - end
    at = content + int(starts[3][2])
    (tmp_path / "in.bag").write_bytes(data[:at] + data[at + missing :])
    losses = recover(tmp_path / "in.bag", tmp_path / "out.bag")
    assert losses
    judge(ros1_messages(whole), ros1_messages(tmp_path / "out.bag"), sum(counts[:3]), counts[3])


SUFFIXES = {"sqlite3": ".db3", "mcap": ".mcap", "ros1": ".bag"}
EACH = 20
T0_NS = 1_700_000_000 * 10**9
ODOMETRY, TEXT = "nav_msgs/msg/Odometry", "std_msgs/msg/String"


@cache
def odometry(number, ros):
    """Return a serialised message of a robot that drives straight on, 0.05 m for each number."""
    place, ahead = (0.05 * number, 0.0, 0.0), (0.5, *[0.0] * 5)
    stamp_ns = T0_NS + number * 10**8
    return serialised(ros, rosmessages.odometry(ros, stamp_ns, place, (0.0, 0.0, 0.0, 1.0), speeds=ahead))


def text(number, ros):
    return serialised(ros, rosmessages.new(ros, "std_msgs/String", f"{number}"))


def write_part(path, storage, numbers):
    """Write messages of two topics as one file, by the rosbags library; return its metadata.yaml, or None."""
    ros = 1 if storage == "ros1" else 2
    if ros == 1:
        writer = Ros1Writer(path)
    else:
        room = path.parent / f".{path.name}"
        writer = Ros2Writer(room, version=9, storage_plugin=StoragePlugin[storage.upper()])
    with writer:
        made = [(writer.add_connection(f"/{name}", kind, typestore=STORES[ros]), make)
                for name, kind, make in (("odom", ODOMETRY, odometry), ("text", TEXT, text))]  # fmt: skip
        for number in numbers:
            for connection, make in made:
                writer.write(connection, T0_NS + number * 10**8, make(number, ros))
    if ros == 1:
        return None
    next(room.glob(f"*{SUFFIXES[storage]}")).rename(path)
    document = YAML(typ="safe").load((room / "metadata.yaml").read_text())
    shutil.rmtree(room)
    return document


def split(room, storage, parts, *, writer="rosbags"):
    """Write a recording of several parts into a folder, with a metadata.yaml if it is of ROS 2; return the parts."""
    room.mkdir()
    files = [room / f"run_{number}{SUFFIXES[storage]}" for number in range(parts)]
    for number, file in enumerate(files):
        document = write_part(file, storage, range(EACH * number, EACH * (number + 1)))
        if writer == "odomcorrupt":
            own = file.with_name(f".own{file.suffix}")
            with open_reader(file) as reader, open_writer(own, reader) as output:
                for block in reader.blocks():
                    output.write(block)
            own.replace(file)
    if document is not None:
        info = document["rosbag2_bagfile_information"]
        info.update(relative_file_paths=[file.name for file in files], message_count=2 * EACH * parts, files=[])
        for entry in info["topics_with_message_count"]:
            entry["message_count"] = EACH * parts
        dump(document, room)
    return files


def dump(document, room):
    YAML(typ="safe").dump(document, room / "metadata.yaml")


def seen(path):
    """Return topic, time and bytes of every message, as the rosbags library reads them."""
    with AnyReader([path], default_typestore=STORES[2]) as reader:
        return Counter((one.topic, time_ns, bytes(data)) for one, time_ns, data in reader.messages())


FILE_DAMAGE = {
    "is gone": lambda file: file.unlink(),
    "is empty": lambda file: file.write_bytes(b""),
    "has five bytes": lambda file: file.write_bytes(file.read_bytes()[:5]),
    "has zeros": lambda file: file.write_bytes(bytes(4096)),
    "has its first page": lambda file: file.write_bytes(file.read_bytes()[:4096]),
    "is cut": lambda file: file.write_bytes(file.read_bytes()[: 2 * file.stat().st_size // 3]),
    "is a pointer": lambda file: file.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n"),
}


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """Return a function that copies a recording of several parts, written once, and what is in each part."""
    room = tmp_path_factory.mktemp("whole")

    @cache
    def written(storage, parts, writer):
        files = split(room / f"{storage} {parts}", storage, parts, writer=writer)
        return files, [seen(file) for file in files]

    def copied(target, *kind):
        files, everything = written(*kind)
        shutil.copytree(files[0].parent, target)
        return [target / file.name for file in files], everything

    return copied


MANY = [(1, 3, "odomcorrupt", True), *((at, 11, "rosbags", False) for at in (10, 5))]
DAMAGED = [*product(FILE_DAMAGE, [(0, 2, "rosbags", True)]), *product(("is gone", "is cut"), MANY)]


@pytest.mark.parametrize(("harm", "at", "parts", "writer", "described"), [(harm, *kind) for harm, kind in DAMAGED])
@pytest.mark.parametrize("storage", SUFFIXES)
def test_all_messages_of_the_other_parts_are_saved_and_the_loss_is_said(
    storage, harm, at, parts, writer, described, whole, tmp_path
):
    room, out = tmp_path / "in", tmp_path / f"out{'.bag' if storage == 'ros1' else ''}"
    files, everything = whole(room, storage, parts, writer)
    if not described:
        (room / "metadata.yaml").unlink(missing_ok=True)
    FILE_DAMAGE[harm](files[at])
    losses = recover(room, out)
    saved = seen(out)
    assert sum(everything[:at] + everything[at + 1 :], Counter()) <= saved <= sum(everything, Counter())
    # without a list nobody knows of parts before the first, or behind the last
    listed = described and storage != "ros1"
    assert bool(losses) == (harm != "is gone" or listed or 0 < at < parts - 1)
    assert all(loss.startswith(str(room)) for loss in losses)
    if storage != "ros1":
        assert info_of(out)["message_count"] == saved.total()


METADATA_DAMAGE = {
    "is gone": lambda path: path.unlink(),
    "is empty": lambda path: path.write_text(""),
    "is cut": lambda path: path.write_text(path.read_text()[: path.stat().st_size // 3]),
    "has zeros": lambda path: path.write_bytes(bytes(500)),
    "is a text": lambda path: path.write_text("hello: [1, 2"),
    "lists nothing": lambda path: path.write_text("rosbag2_bagfile_information:\n  version: 9\n"),
}


@pytest.mark.parametrize("harm", METADATA_DAMAGE)
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_damaged_metadata_file_costs_no_message(storage, harm, tmp_path):
    files = split(tmp_path / "in", storage, 3)
    expected = sum((seen(file) for file in files), Counter())
    METADATA_DAMAGE[harm](tmp_path / "in" / "metadata.yaml")
    if harm != "is gone":
        with pytest.raises(BagError, match=r"metadata\.yaml: .*; recover=True does without it"):
            open_reader(tmp_path / "in")
    losses = recover(tmp_path / "in", tmp_path / "out")
    assert seen(tmp_path / "out") == expected
    assert len(losses) == (harm != "is gone")
    assert info_of(tmp_path / "out")["relative_file_paths"] == [file.name for file in files]


def _paths(info, before, **more):
    info.update(relative_file_paths=[before + name for name in info["relative_file_paths"]], **more)


STATED = {
    "no storage": lambda info: info.update(storage_identifier=""),
    "another storage": lambda info: info.update(storage_identifier="rosbag_v2"),
    "counts of 0": lambda info: info.update(message_count=0, duration={"nanoseconds": 0}),
    "a topic missing": lambda info: info["topics_with_message_count"].pop(1),
    "no topics": lambda info: info.pop("topics_with_message_count"),
    "topics that are none": lambda info: info.update(topics_with_message_count=[3, "x"]),
    "times of a year": lambda info: info.update(starting_time={"nanoseconds_since_epoch": 1}),
    "no version": lambda info: info.pop("version"),
    "a version in quotes": lambda info: info.update(version="9"),
    "another type": lambda info: info["topics_with_message_count"][0]["topic_metadata"].update(type="a/msg/B"),
    "files of another bag": lambda info: info.update(files=[{"path": "other.db3", "message_count": 5}]),
    "files elsewhere": lambda info: _paths(info, "/", files=[{"path": "/run_0.db3"}], custom_data=["x"]),
    "files of the version before 4": lambda info: _paths(info, "in/", version=3),
}


@pytest.mark.parametrize("wrong", STATED)
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_what_is_stated_is_what_was_counted(storage, wrong, tmp_path, capsys):
    files = split(tmp_path / "in", storage, 2)
    document = YAML(typ="safe").load((tmp_path / "in" / "metadata.yaml").read_text())
    STATED[wrong](document["rosbag2_bagfile_information"])
    dump(document, tmp_path / "in")
    assert run([str(tmp_path / "in"), str(tmp_path / "out"), "--seed", "3", "-v"]) == 0
    said = {"counts of 0": "states 0 messages, the files hold 80", "a topic missing": "does not list /text (",
            "no storage": "states the storage '',", "another type": "does not list /odom (nav_msgs"}  # fmt: skip
    assert said.get(wrong, "") in capsys.readouterr().err
    info = info_of(tmp_path / "out")
    assert info["storage_identifier"] == storage
    assert "a/msg/B" not in {one["topic_metadata"]["type"] for one in info["topics_with_message_count"]}
    assert info["message_count"] == seen(tmp_path / "out").total() == 4 * EACH
    assert info["starting_time"]["nanoseconds_since_epoch"] == T0_NS
    assert info["duration"]["nanoseconds"] == (2 * EACH - 1) * 10**8
    assert {one["topic_metadata"]["name"]: one["message_count"] for one in info["topics_with_message_count"]} == {
        "/odom": 2 * EACH, "/text": 2 * EACH,
    }  # fmt: skip
    listed = info["version"] > 3
    assert info["relative_file_paths"] == ["out/" * (not listed) + file.name for file in files]
    assert [one["path"] for one in info["files"]] == [file.name for file in files] * listed
    assert [one["message_count"] for one in info["files"]] == [2 * EACH, 2 * EACH] * listed


@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_packed_part_that_is_damaged_is_named_as_it_lies_there(storage, tmp_path):
    files = split(tmp_path / "in", storage, 3)
    expected = sum((seen(file) for file in files[:2]), Counter())
    for number, file in enumerate(files):
        data = zstandard.compress(file.read_bytes())
        file.with_name(f"{file.name}.zstd").write_bytes(data if number < 2 else data[:10])
        file.unlink()
    (tmp_path / "in" / "metadata.yaml").unlink()
    with pytest.raises(BagError, match=rf"in/{files[2].name}\.zstd"):
        open_reader(tmp_path / "in")
    losses = recover(tmp_path / "in", tmp_path / "out")
    assert seen_unpacked(tmp_path / "out", tmp_path / "plain") >= expected
    assert losses
    assert all(loss.startswith(str(tmp_path / "in")) for loss in losses)


def seen_unpacked(bag, room):
    """Return the messages of a bag whose files are compressed."""
    room.mkdir()
    for file in bag.glob("*.zstd"):
        (room / file.stem).write_bytes(zstandard.ZstdDecompressor().decompressobj().decompress(file.read_bytes()))
    return sum((seen(file) for file in room.iterdir()), Counter())


def test_a_part_of_ros_1_that_was_being_written_belongs_to_the_recording(tmp_path):
    files = split(tmp_path / "in", "ros1", 3)
    expected = sum((seen(file) for file in files), Counter())
    files[2].rename(tmp_path / "in" / "run_2.bag.active")
    assert count_of(tmp_path / "in") == expected.total()


@pytest.mark.parametrize("named", ["run_{}.bag", "run_2024-01-02-10-0{}-00_{}.bag"])
@pytest.mark.parametrize("way", ["folder", "files", "pattern", "files, -o"])
def test_parts_of_ros_1_are_one_drive(named, way, tmp_path, monkeypatch, capsys, invoke):
    files = split(tmp_path / "in", "ros1", 3)
    whole = tmp_path / "whole.bag"
    write_part(whole, "ros1", range(3 * EACH))
    monkeypatch.chdir(tmp_path)
    names = [named.format(*[number] * 2) for number in range(3)]
    for file, name in zip(files, names, strict=True):
        file.rename(file.with_name(name))
    words = {"folder": ["in"], "pattern": ["in/run_*.bag"]}.get(way, [f"in/{name}" for name in names])
    assert run([*words, *["-o"] * way.endswith("-o"), "out.bag", "--seed", "3", "-q"]) == 0
    assert run(["whole.bag", "same.bag", "--seed", "3", "-q"]) == 0
    assert seen(tmp_path / "out.bag") == seen(tmp_path / "same.bag")
    assert capsys.readouterr().err == ""
    assert "ODOMETRY  /odom" in invoke(["info", *words]).out
    assert run(["batch", *words, "runs", "--runs", "1", "--seed", "3"]) == 0
    assert seen(tmp_path / "runs" / "run_000000.bag") == seen(tmp_path / "out.bag")
    assert ("3 inputs are the parts of one recording, in/run_" in capsys.readouterr().err) == way.startswith("files")


@pytest.mark.parametrize("at", [0, 1, 2])
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_part_that_is_not_listed_is_said_and_recovered(storage, at, tmp_path, invoke):
    files = split(tmp_path / "in", storage, 3)
    document = YAML(typ="safe").load((tmp_path / "in" / "metadata.yaml").read_text())
    document["rosbag2_bagfile_information"]["relative_file_paths"].remove(files[at].name)
    dump(document, tmp_path / "in")
    for words, done, count in (([], "left out; --recover reads", 2), (["--recover"], "read, as a part of", 3)):
        said = " ".join(invoke([tmp_path / "in", tmp_path / f"out{count}", "--seed", "3", *words]).err.split())
        assert f"metadata.yaml does not list {files[at].name}: {done}" in said
        assert seen(tmp_path / f"out{count}").total() == count * 2 * EACH


def test_under_recover_the_summary_says_what_is_lost_of_parts_and_of_metadata(tmp_path, capsys, invoke):
    files = split(tmp_path / "in", "mcap", 3)
    files[2].write_bytes(b"")
    assert (
        "LOST      run_2.mcap is empty" in invoke([tmp_path / "in", tmp_path / "a", "--seed", "3", "--recover"], 3).err
    )
    METADATA_DAMAGE["is cut"](tmp_path / "in" / "metadata.yaml")
    files[2].unlink()
    assert run([str(tmp_path / "in"), str(tmp_path / "b"), "--seed", "3", "--recover"]) == 3
    assert "LOST      metadata.yaml cannot be read" in capsys.readouterr().err


def test_several_inputs_that_are_no_recording_are_refused_with_the_way_out(tmp_path, monkeypatch, capsys, invoke):
    monkeypatch.chdir(tmp_path)
    for name in ("a.bag", "b.bag", "c_0.bag", "c_1.bag", "c_2.bag"):
        write_part(tmp_path / name, "ros1", range(3))
    assert run(["a.bag", "b.bag", "out.bag"]) == 2
    assert "2 inputs (a.bag, b.bag, ...) are not evidently the parts of one recording" in capsys.readouterr().err
    assert run(["c_0.bag", "c_1.bag", "out.bag"]) == 2
    assert "c_2.bag: part of the same recording; name it, too, or write 'c_[0-9]*.bag'" in capsys.readouterr().err
    assert "unexpected extra argument: out.bag does not exist" in invoke(["a.bag", "out.bag", "third"], 2).err


NAMES = {
    "/lidar/bottom/1_2v": "/lidar/bottom/_1_2v", "/camera-1/info": "/camera_1/info",
    "/device_0/Enable Auto Exposure": "/device_0/Enable_Auto_Exposure", "/a//b": "/a/b", "/tail/": "/tail",
    "/plain": "/plain", "/camera_1/info": "/camera_1/info", "/~own": "/_own",
}  # fmt: skip


def test_names_that_ros_2_forbids_are_said_and_renamed_and_distinct(tmp_path, invoke):
    source = tmp_path / "in.bag"
    with Ros1Writer(source) as writer:
        for number, name in enumerate(("/odom-1", *NAMES)):
            kind, make = (ODOMETRY, odometry) if name == "/odom-1" else (TEXT, text)
            connection = writer.add_connection(name, kind, typestore=STORES[1])
            for index in range(EACH):
                writer.write(connection, T0_NS + index * 10**8 + number, make(index, 1))
    words = ["--odom-topic", "/odom-1", "--seed", "3", "--rename", "/tail/=/end", "-v"]
    said = invoke([source, tmp_path / "out", *words]).err
    expected = {**NAMES, "/camera-1/info": "/camera_1/info_", "/tail/": "/end", "/odom-1": "/odom_1"}
    assert {topic for topic, _, _ in seen(tmp_path / "out")} == set(expected.values())
    for old, new in expected.items():
        assert (f"{old} is now {new}" in said) == (old not in (new, "/tail/"))
    assert run([str(source), str(tmp_path / "again.bag"), "--seed", "3", "-q"]) == 0
    with open_reader(tmp_path / "again.bag") as reader:
        assert {channel.topic for channel in reader.channels.values()} == set(expected)


@pytest.mark.parametrize(
    ("rename", "words"), [("/none=/a", "has no such topic"), ("/text=/odom", "would both be /odom"),
                          ("/text=/1a", "no digit first"), ("/text", "write OLD=NEW")]
)  # fmt: skip
def test_a_name_that_cannot_be_is_refused(rename, words, tmp_path):
    split(tmp_path / "in", "mcap", 1)
    with pytest.raises(oc.OdomCorruptError, match=words):
        oc.corrupt(tmp_path / "in", tmp_path / "out", rename=(rename,))
    assert not (tmp_path / "out").exists()


def test_topics_are_renamed_in_any_bag_and_in_a_batch(tmp_path):
    split(tmp_path / "in", "sqlite3", 1)
    oc.corrupt(tmp_path / "in", tmp_path / "out.mcap", rename=("/text=/said", "odom=/odometry"), seed=1)
    assert {topic for topic, _, _ in seen(tmp_path / "out.mcap")} == {"/said", "/odometry"}
    assert run(["batch", str(tmp_path / "in"), str(tmp_path / "runs"), "--runs", "2", "--seed", "1", "--to", "mcap",
                "--rename", "/text=/said", "-q"]) == 0  # fmt: skip
    files = sorted((tmp_path / "runs").rglob("*.mcap"))
    assert len(files) == 2
    assert all({topic for topic, _, _ in seen(file)} == {"/said", "/odom"} for file in files)

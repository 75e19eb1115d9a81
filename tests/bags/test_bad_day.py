"""What people have after a bad day: parts that are empty, cut or gone, and a metadata.yaml that is not what it says.

Bags are generated over storage, writer, number of parts and damage; what is saved is counted by the rosbags library.
"""

import shutil
from collections import Counter
from functools import cache
from itertools import product

import pytest
import zstandard
from oracles import count_of, info_of
from rosbags.highlevel import AnyReader
from rosbags.rosbag1 import Writer as Ros1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Ros2Writer
from ruamel.yaml import YAML
from test_recover import recover

import odomcorrupt as oc
import rosmessages
from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.cli import run
from odomcorrupt.errors import BagError
from rosmessages import STORES, serialised

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
def test_parts_of_ros_1_are_one_drive(named, way, tmp_path, monkeypatch, capsys):
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
    assert run(["info", *words]) == 0
    assert "ODOMETRY  /odom" in capsys.readouterr().out
    assert run(["batch", *words, "runs", "--runs", "1", "--seed", "3"]) == 0
    assert seen(tmp_path / "runs" / "run_000000.bag") == seen(tmp_path / "out.bag")
    assert ("3 inputs are the parts of one recording, in/run_" in capsys.readouterr().err) == way.startswith("files")


@pytest.mark.parametrize("at", [0, 1, 2])
@pytest.mark.parametrize("storage", ["sqlite3", "mcap"])
def test_a_part_that_is_not_listed_is_said_and_recovered(storage, at, tmp_path, capsys):
    files = split(tmp_path / "in", storage, 3)
    document = YAML(typ="safe").load((tmp_path / "in" / "metadata.yaml").read_text())
    document["rosbag2_bagfile_information"]["relative_file_paths"].remove(files[at].name)
    dump(document, tmp_path / "in")
    for words, done, count in (([], "left out; --recover reads", 2), (["--recover"], "read, as a part of", 3)):
        assert run([str(tmp_path / "in"), str(tmp_path / f"out{count}"), "--seed", "3", *words]) == 0
        said = " ".join(capsys.readouterr().err.split())
        assert f"metadata.yaml does not list {files[at].name}: {done}" in said
        assert seen(tmp_path / f"out{count}").total() == count * 2 * EACH


def test_under_recover_the_summary_says_what_is_lost_of_parts_and_of_metadata(tmp_path, capsys):
    files = split(tmp_path / "in", "mcap", 3)
    files[2].write_bytes(b"")
    assert run([str(tmp_path / "in"), str(tmp_path / "a"), "--seed", "3", "--recover"]) == 3
    assert "LOST      run_2.mcap is empty" in capsys.readouterr().err
    METADATA_DAMAGE["is cut"](tmp_path / "in" / "metadata.yaml")
    files[2].unlink()
    assert run([str(tmp_path / "in"), str(tmp_path / "b"), "--seed", "3", "--recover"]) == 3
    assert "LOST      metadata.yaml cannot be read" in capsys.readouterr().err


def test_several_inputs_that_are_no_recording_are_refused_with_the_way_out(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("a.bag", "b.bag", "c_0.bag", "c_1.bag", "c_2.bag"):
        write_part(tmp_path / name, "ros1", range(3))
    assert run(["a.bag", "b.bag", "out.bag"]) == 2
    assert "2 inputs (a.bag, b.bag, ...) are not evidently the parts of one recording" in capsys.readouterr().err
    assert run(["c_0.bag", "c_1.bag", "out.bag"]) == 2
    assert "c_2.bag: part of the same recording; name it, too, or write 'c_[0-9]*.bag'" in capsys.readouterr().err
    assert run(["a.bag", "out.bag", "third"]) == 2
    assert "unexpected extra argument: out.bag does not exist" in capsys.readouterr().err


NAMES = {
    "/lidar/bottom/1_2v": "/lidar/bottom/_1_2v", "/camera-1/info": "/camera_1/info",
    "/device_0/Enable Auto Exposure": "/device_0/Enable_Auto_Exposure", "/a//b": "/a/b", "/tail/": "/tail",
    "/plain": "/plain", "/camera_1/info": "/camera_1/info", "/~own": "/_own",
}  # fmt: skip


def test_names_that_ros_2_forbids_are_said_and_renamed_and_distinct(tmp_path, capsys):
    source = tmp_path / "in.bag"
    with Ros1Writer(source) as writer:
        for number, name in enumerate(("/odom-1", *NAMES)):
            kind, make = (ODOMETRY, odometry) if name == "/odom-1" else (TEXT, text)
            connection = writer.add_connection(name, kind, typestore=STORES[1])
            for index in range(EACH):
                writer.write(connection, T0_NS + index * 10**8 + number, make(index, 1))
    words = ["--odom-topic", "/odom-1", "--seed", "3", "--rename", "/tail/=/end", "-v"]
    assert run([str(source), str(tmp_path / "out"), *words]) == 0
    said = capsys.readouterr().err
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

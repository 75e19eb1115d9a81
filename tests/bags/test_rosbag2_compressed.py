"""ROS 2 bags compressed by file or by message, in and out."""

import io
from collections import Counter

import pytest
import zstandard
from bagged import messages_in
from oracles import OFFICE, copy, info_of, mcap_messages, rewritten
from rosbags.rosbag2 import CompressionFormat, CompressionMode, Reader, StoragePlugin
from rosbags.rosbag2 import Writer as Ros2LibraryWriter
from ruamel.yaml import YAML

from odomcorrupt.bags import source as reading
from odomcorrupt.bags.open import open_reader
from odomcorrupt.bags.source import VARIABLE
from odomcorrupt.cli import run
from odomcorrupt.errors import BagError

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

"""An uncompressed bag copied by the kernel and then changed has the same bytes as one written completely."""

import errno
import os
import shutil
import threading
import time
from itertools import count
from pathlib import Path

import pytest
from mcap.writer import CompressionType
from mcap.writer import Writer as McapLibraryWriter
from oracles import FIXTURES, OFFICE, OFFICE_DB
from rosbags.rosbag1 import Writer as Ros1LibraryWriter

from odomcorrupt.bags.open import open_reader
from odomcorrupt.bags.output import Output
from odomcorrupt.bags.rosbag2 import sqlite_writer
from odomcorrupt.corruption.run import Container, corrupt_bag
from odomcorrupt.corruption.transform import Options
from odomcorrupt.errors import BagError
from odomcorrupt.model.motion_model import MotionModel, Noise
from odomcorrupt.model.noise_laws import Coefficients

MODEL = MotionModel(Noise("diffusion", Coefficients(0.05, 0.02, 0.05, 0.01)))


def full(*_words):
    raise OSError(errno.ENOSPC, "No space left on device")


def corrupt(source, target, threads=2, *, recover=False, compression=None, **options):
    container = Container(threads=threads, recover=recover, compression=compression, overwrite=True)
    corrupt_bag(source, target, MODEL, seed=7, run=0, options=Options(**options), container=container)
    return (target if target.is_file() else target / OFFICE_DB.name).read_bytes()


def messages(name):
    """Yield the first messages of a fixture, and between them large messages that corruption leaves unchanged."""
    numbers = count()
    with open_reader(FIXTURES / name) as reader:
        for block in reader.blocks():
            for channel, log_ns, offset, length in block.table.tolist():
                yield reader.channels[channel], log_ns, block.data[offset : offset + length].tobytes()
                if (number := next(numbers)) % 10 == 0:
                    yield None, log_ns, bytes([number % 251]) * 40_000
                if number > 1500:
                    return


def write_mcap(path, **options):
    with path.open("wb") as stream, open_reader(FIXTURES / "office.mcap") as reader:
        writer = McapLibraryWriter(stream, chunk_size=1 << 18, compression=CompressionType.NONE, **options)
        writer.start("ros2", "test")
        ids = {None: writer.register_channel("/noise", "raw", 0)}
        for channel in reader.channels.values():
            definition = reader.definition(channel)
            schema = writer.register_schema(definition.name, definition.encoding, definition.text)
            ids[channel.id] = writer.register_channel(channel.topic, channel.encoding, schema)
        writer.add_metadata("test", {"a": "b"})
        for channel, log_ns, data in messages("office.mcap"):
            writer.add_message(ids[channel and channel.id], log_ns, data, log_ns)
        writer.finish()
    return path


def write_ros1(path):
    with Ros1LibraryWriter(path) as writer, open_reader(FIXTURES / "office.bag") as reader:
        writer.chunk_threshold = 1 << 18
        ids = {None: writer.add_connection("/noise", "a/msg/Noise", msgdef="uint8[] data", md5sum="0" * 32)}
        for channel in reader.channels.values():
            fields = channel.raw.fields
            text, md5 = fields["message_definition"].decode(), fields["md5sum"].decode()
            ids[channel.id] = writer.add_connection(channel.topic, channel.msgtype, msgdef=text, md5sum=md5)
        for channel, log_ns, data in messages("office.bag"):
            writer.write(ids[channel and channel.id], log_ns, data)
    return path


@pytest.fixture(scope="module", params=["mcap", "bag"])
def bag(request, tmp_path_factory):
    path = tmp_path_factory.mktemp("bag") / f"in.{request.param}"
    return write_mcap(path) if request.param == "mcap" else write_ros1(path)


@pytest.fixture
def copied(monkeypatch):
    """Return the number of bytes copied by each call of the kernel's copy."""
    sizes, call = [], os.copy_file_range

    def counted(*words):
        sizes.append(call(*words))
        return sizes[-1]

    monkeypatch.setattr("os.copy_file_range", counted)
    return sizes


def test_the_copy_makes_the_same_bytes(bag, tmp_path, copied):
    one = corrupt(bag, tmp_path / f"one{bag.suffix}", 1)
    assert not copied
    assert corrupt(bag, tmp_path / f"two{bag.suffix}", 2) == one
    assert sum(copied) > 0.9 * bag.stat().st_size
    assert threading.active_count() == 1


@pytest.mark.parametrize("most", [0, 1 << 30])
def test_changes_that_wait_for_the_copy_are_all_written(bag, most, tmp_path, monkeypatch):
    call, one = os.copy_file_range, corrupt(bag, tmp_path / f"one{bag.suffix}", 1)
    monkeypatch.setattr("os.copy_file_range", lambda a, b, size, *at: call(a, b, min(size, 1 << 16), *at))
    monkeypatch.setattr("odomcorrupt.bags.output._KEPT_BYTES", most)
    assert corrupt(bag, tmp_path / f"two{bag.suffix}") == one


@pytest.mark.parametrize("options", [{"keep_truth": "/odom_true"}, {"new_odom_frame": "odom1"}, {"recover": True}])
def test_messages_that_are_added_move_the_rest(bag, options, tmp_path):
    one, two = (corrupt(bag, tmp_path / f"{n}{bag.suffix}", n, **options) for n in (1, 2))
    assert one == two


@pytest.mark.parametrize("good", [0, 1])
def test_a_copy_that_fails_is_made_by_writing(bag, good, tmp_path, monkeypatch):
    one, call, calls = corrupt(bag, tmp_path / f"one{bag.suffix}", 1), os.copy_file_range, count()

    def some(source, target, size, *places):
        return (full if next(calls) >= good else call)(source, target, min(size, 1 << 20), *places)

    monkeypatch.setattr("os.copy_file_range", some)
    assert corrupt(bag, tmp_path / f"two{bag.suffix}") == one


@pytest.mark.parametrize("compression", [None, "lz4"])
@pytest.mark.parametrize("good", [0, 3])
def test_a_disk_that_is_full_leaves_nothing(bag, compression, good, tmp_path, monkeypatch):
    call, calls = os.pwrite, count()
    monkeypatch.setattr("os.pwrite", lambda *words: full() if next(calls) >= good else call(*words))
    monkeypatch.setattr("odomcorrupt.bags.output._KEPT_BYTES", 0)
    with pytest.raises(BagError, match="cannot be written: No space left on device"):
        corrupt(bag, tmp_path / f"out{bag.suffix}", compression=compression)
    assert [*tmp_path.iterdir(), *threading.enumerate()[1:]] == []


def test_writes_of_a_part_are_continued(bag, tmp_path, monkeypatch):
    one, call = corrupt(bag, tmp_path / f"one{bag.suffix}", 1, compression="lz4"), os.pwrite
    monkeypatch.setattr("os.pwrite", lambda file, view, at: call(file, view[: len(view) // 2 + 1], at))
    assert corrupt(bag, tmp_path / f"two{bag.suffix}", compression="lz4") == one


def test_an_input_that_changes_under_the_copy_leaves_nothing(bag, tmp_path, monkeypatch):
    source, call = Path(shutil.copy(bag, tmp_path / f"in{bag.suffix}")), os.copy_file_range

    def changed(*words):
        os.utime(source)
        return call(*words)

    monkeypatch.setattr("os.copy_file_range", changed)
    os.utime(source, ns=(0, 0))
    with pytest.raises(BagError, match="changed while it was read"):
        corrupt(source, tmp_path / f"out{bag.suffix}")
    assert [*tmp_path.iterdir(), *threading.enumerate()[1:]] == [source]


@pytest.mark.parametrize("replaced", [False, True])
def test_an_input_that_is_moved_away_is_written_as_it_was_read(bag, replaced, tmp_path, monkeypatch, copied):
    one, write = corrupt(bag, tmp_path / f"one{bag.suffix}", 1), Output.write_summed
    source = Path(shutil.copy(bag, tmp_path / f"in{bag.suffix}"))

    def late(output, piece, crc, original=None):
        if source.exists() and not replaced:
            source.unlink()
        elif replaced:
            (tmp_path / "other").write_bytes(b"another")
            (tmp_path / "other").replace(source)
        write(output, piece, crc, original)

    monkeypatch.setattr(Output, "write_summed", late)
    assert corrupt(source, tmp_path / f"two{bag.suffix}") == one
    assert not copied


def interrupted(*_words):
    raise KeyboardInterrupt


def test_an_interrupt_ends_the_copy(bag, tmp_path, monkeypatch):
    monkeypatch.setattr(Output, "commit", interrupted)
    with pytest.raises(KeyboardInterrupt):
        corrupt(bag, tmp_path / f"out{bag.suffix}")
    assert not [*tmp_path.iterdir(), *threading.enumerate()[1:]]


@pytest.mark.parametrize(
    ("source", "held", "options", "slow"), [(OFFICE, 0, {}, True),
    (OFFICE, 16 << 20, {"keep_truth": "/odom_true"}, True), (OFFICE_DB, 0, {"keep_truth": "/odom_true"}, False),
    (OFFICE_DB, 16 << 20, {}, False)]
)  # fmt: skip
def test_the_thread_changes_no_byte(source, held, options, slow, tmp_path, monkeypatch):
    monkeypatch.setattr(sqlite_writer, "_HELD_BYTES", held)
    one = corrupt(source, tmp_path / f"one{source.suffix}", 1, **options)
    if slow:
        copy = os.copy_file_range
        monkeypatch.setattr("os.copy_file_range", lambda *words: (time.sleep(0.1), copy(*words))[1])
    assert corrupt(source, tmp_path / f"two{source.suffix}", 2, **options) == one
    assert threading.active_count() == 1


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("source", [OFFICE, OFFICE_DB], ids=["directory", "file"])
def test_a_copy_of_a_database_that_fails_is_a_line(source, threads, tmp_path, monkeypatch):
    monkeypatch.setattr("os.copy_file_range", full)
    monkeypatch.setattr(shutil, "copyfile", full)
    with pytest.raises(BagError, match="cannot be written: No space left on device"):
        corrupt(source, tmp_path / f"out{source.suffix}", threads)
    assert list(tmp_path.iterdir()) == []
    assert threading.active_count() == 1


def test_without_such_a_call_the_copy_is_made_in_python(tmp_path, monkeypatch):
    one = corrupt(OFFICE_DB, tmp_path / "one.db3", 2)
    monkeypatch.delattr("os.copy_file_range")
    assert corrupt(OFFICE_DB, tmp_path / "two.db3", 2) == one


def test_an_interrupt_ends_the_copy_too(tmp_path, monkeypatch):
    def endless(*_words):
        time.sleep(0.01)
        return 1

    monkeypatch.setattr("os.copy_file_range", endless)
    monkeypatch.setattr("odomcorrupt.corruption.transform.Transform.blocks", interrupted)
    with pytest.raises(KeyboardInterrupt):
        corrupt(OFFICE_DB, tmp_path / "out.db3", 2)
    assert list(tmp_path.iterdir()) == []
    assert threading.active_count() == 1


def test_a_message_that_changes_meanwhile_in_the_input_is_no_part_of_an_output(tmp_path, monkeypatch):
    source, call = write_mcap(tmp_path / "in.mcap"), Output.write_summed

    def late(output, piece, crc, original=None):
        if original:
            source.write_bytes(source.read_bytes().replace(bytes(100), bytes([1] * 100)))
        call(output, piece, crc, original)

    monkeypatch.setattr(Output, "write_summed", late)
    with pytest.raises(BagError, match="changed while it was read"):
        corrupt(source, tmp_path / "out.mcap")
    assert list(tmp_path.iterdir()) == [source]

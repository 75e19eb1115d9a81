"""Bags are known by their content, and appear complete or not at all."""

import bz2
import gzip
import io
import lzma
import os
import shutil
import stat
import threading

import lz4.frame
import pytest
from mcap.writer import Writer as McapLibraryWriter
from oracles import OFFICE, OFFICE_BAG, OFFICE_DB, OFFICE_MCAP, copy, mcap_messages
from rosbags.rosbag1 import Writer as Ros1LibraryWriter

from odomcorrupt.bags.mcap.writer import ChannelTable
from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.bags.ros1.writer import Connections
from odomcorrupt.bags.source import Source
from odomcorrupt.errors import BagError


@pytest.mark.parametrize(("source", "kind"), [(OFFICE_BAG, "ros1"), (OFFICE_MCAP, "mcap")])
def test_content_tells_the_format_not_the_name(source, kind, tmp_path):
    renamed = tmp_path / "recording.data"
    renamed.write_bytes(source.read_bytes())
    with open_reader(renamed) as reader:
        assert reader.kind == kind
    out = copy(renamed, tmp_path / f"out{source.suffix}")
    with open_reader(out) as reader:
        assert reader.kind == kind
    with open_reader(None, io.BytesIO(source.read_bytes())) as reader:
        assert (reader.kind, reader.complete) == (kind, False)


@pytest.mark.parametrize(
    ("content", "words"),
    [(b"", "is empty"), (b"#ROSBAG V1.2\n", "version 1; `rosbag migrate`"),
    (gzip.compress(b"a bag", mtime=0), "is a gzip-compressed file; decompress it first .`gunzip`"),
    (bz2.compress(b"a bag"), "`bunzip2`"), (lzma.compress(b"a bag"), "`unxz`"),
    (lz4.frame.compress(b"a bag"), "`lz4 -d`"), (b"PK\3\4 and so on", "zip archive"),
    (b"#EXTM3U", "not an MCAP, a ROS 1 bag or a ROS 2 bag"), (bytes(4096), "never written"),
    (b"version https://git-lfs.github.com/spec/v1\noid sha256:0", "`git lfs pull`"),
    (b"\n\n <!DOCTYPE html>\n<html>", "HTML page"),
    (b"rosbag2_bagfile_information:\n  version: 5", "name its directory")],
)  # fmt: skip
def test_what_is_no_bag_is_refused_with_what_was_found(content, words, tmp_path):
    (tmp_path / "in").write_bytes(content)
    with pytest.raises(BagError, match=words):
        open_reader(tmp_path / "in")
    with pytest.raises(BagError, match=words):
        open_reader(None, io.BytesIO(content))


def test_what_is_compressed_by_zstd_is_read_from_a_file_alone(tmp_path):
    (tmp_path / "in").write_bytes(b"\x28\xb5\x2f\xfd compressed")
    with pytest.raises(BagError, match="zstd cannot decompress it"):
        open_reader(tmp_path / "in")
    with pytest.raises(BagError, match=r"decompress it first .`zstd -d`"):
        open_reader(None, io.BytesIO((tmp_path / "in").read_bytes()))


@pytest.mark.parametrize("name", ["in.mcap", "link.mcap", OFFICE.name, f"{OFFICE.name}/{OFFICE_DB.name}"])
def test_the_input_is_never_the_output(name, tmp_path):
    (tmp_path / "in.mcap").write_bytes(OFFICE_MCAP.read_bytes())
    (tmp_path / "link.mcap").symlink_to(tmp_path / "in.mcap")
    shutil.copytree(OFFICE, tmp_path / OFFICE.name)
    source = (tmp_path / name).resolve()
    with open_reader(source) as reader, pytest.raises(BagError, match="is the input"):
        open_writer(tmp_path / name, reader, overwrite=True)
    assert (tmp_path / "in.mcap").read_bytes() == OFFICE_MCAP.read_bytes()


def test_an_input_and_an_output_that_are_nowhere_are_refused(tmp_path):
    with pytest.raises(BagError, match=r"nothing\.mcap: cannot be opened"):
        open_reader(tmp_path / "nothing.mcap")
    with open_reader(OFFICE_MCAP) as reader, pytest.raises(BagError, match="does not exist"):
        open_writer(tmp_path / "no" / "out.mcap", reader)


@pytest.mark.parametrize("source", [OFFICE_BAG, OFFICE_MCAP, OFFICE, OFFICE_DB])
@pytest.mark.parametrize("failure", [KeyboardInterrupt, ValueError, SystemExit])
def test_a_failure_leaves_nothing_and_what_was_there_before(source, failure, tmp_path):
    target = tmp_path / f"out{source.suffix}"
    for there in (False, True):
        if there:
            copy(source, target)
        before = {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")}

        def fail(_reader, _writer, _block):
            assert len(list(tmp_path.iterdir())) == 1 + target.exists()
            raise failure

        with pytest.raises(failure):
            copy(source, target, fail, overwrite=True)
        assert {path: path.is_file() and path.read_bytes() for path in tmp_path.rglob("*")} == before


def test_the_output_has_the_permissions_of_any_new_file(tmp_path):
    (tmp_path / "plain").touch()
    copy(OFFICE_MCAP, tmp_path / "out.mcap")
    assert stat.S_IMODE((tmp_path / "out.mcap").stat().st_mode) == stat.S_IMODE((tmp_path / "plain").stat().st_mode)


@pytest.mark.parametrize(("name", "codec"), [("out.mcap", "bz2"), ("out.bag", "zstd"), ("out.bag", "snappy")])
def test_a_compression_that_a_format_cannot_have_is_refused(name, codec, tmp_path):
    with open_reader(OFFICE_BAG) as reader, pytest.raises(BagError, match=codec):
        open_writer(tmp_path / name, reader, compression=codec)


def test_a_named_pipe_is_written_to_and_not_replaced(tmp_path):
    fifo = tmp_path / "out.mcap"
    os.mkfifo(fifo)
    got = []
    thread = threading.Thread(target=lambda: got.append(fifo.read_bytes()))
    thread.start()
    copy(OFFICE_MCAP, fifo)
    thread.join()
    assert stat.S_ISFIFO(fifo.stat().st_mode)
    assert got == [copy(OFFICE_MCAP, tmp_path / "plain.mcap").read_bytes()]


def test_a_reader_that_goes_away_is_an_error():
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "wb", buffering=0) as stdout, pytest.raises(BagError, match="closed by its reader"):
        copy(OFFICE_MCAP, None, stream=stdout)


def test_blocks_have_buffers_of_their_own():
    for path in (OFFICE_BAG, OFFICE_MCAP):
        with open_reader(path) as reader:
            blocks = list(reader.blocks())
        sums = [block.data.sum() for block in blocks]
        for block in blocks:
            assert block.data.flags.writeable
            block.data[:] = 0
        assert all(sums)


@pytest.mark.parametrize("suffix", [".bag", ".mcap"])
def test_a_bag_without_messages_stays_one(suffix, tmp_path):
    source = tmp_path / f"in{suffix}"
    if suffix == ".bag":
        with Ros1LibraryWriter(source):
            pass
    else:
        with source.open("wb") as stream:
            writer = McapLibraryWriter(stream)
            writer.start()
            writer.finish()
    out = copy(source, tmp_path / f"out{suffix}")
    with open_reader(out) as reader:
        assert not reader.channels
        assert not list(reader.blocks())
    assert mcap_messages(copy(source, tmp_path / "out.copy.mcap")) == []


@pytest.mark.parametrize(("source", "codec"), [(OFFICE_MCAP, "none"), (OFFICE_BAG, "none"), (OFFICE, None)])
def test_a_level_without_a_compression_is_refused(source, codec, tmp_path):
    with open_reader(source) as reader, pytest.raises(BagError, match="level 3: without compression"):
        open_writer(tmp_path / f"out{source.suffix}", reader, compression=codec, level=3)


def test_a_level_that_a_compression_does_not_have_is_refused_before_anything_is_written(tmp_path):
    with open_reader(OFFICE_MCAP) as reader, pytest.raises(BagError, match="level 40"):
        open_writer(tmp_path / "out.mcap", reader, compression="zstd", level=40)
    with pytest.raises(BagError, match="level 40"):
        copy(OFFICE_MCAP, tmp_path / "out.mcap", level=40)
    assert not any(tmp_path.iterdir())


def test_a_named_pipe_is_read_as_a_pipe(tmp_path):
    fifo = tmp_path / "in.mcap"
    os.mkfifo(fifo)
    thread = threading.Thread(target=lambda: fifo.write_bytes(OFFICE_MCAP.read_bytes()))
    thread.start()
    with open_reader(fifo) as reader:
        assert not reader.complete
        assert sum(len(block.table) for block in reader.blocks()) == 9325
    thread.join()


@pytest.mark.parametrize("source", [OFFICE_MCAP, OFFICE_BAG])
def test_a_channel_that_is_neither_in_the_bag_nor_added_is_refused(source):
    with open_reader(source) as reader:
        with pytest.raises(BagError, match="channel 60000: is neither in the bag nor added to it"):
            ChannelTable(reader).written_id(60000)
        if source == OFFICE_BAG:
            with pytest.raises(BagError, match="channel 60000: is neither in the bag nor added to it"):
                Connections(reader).take_records([60000])


class Broken(io.RawIOBase):
    """A stream on a disk that fails."""

    def readable(self):
        return True

    def read(self, _size=-1):
        raise OSError(5, os.strerror(5))

    readinto = read


def test_a_pipe_that_fails_is_reported():
    with pytest.raises(BagError, match="stdin: cannot be copied to a temporary file: Input/output error"):
        Source(Broken(), "stdin").spooled()
    with pytest.raises(BagError, match="stdin: cannot be read: Input/output error"):
        Source(Broken(), "stdin").read_array(10, "magic")

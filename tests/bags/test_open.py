"""Bags are known by their content, are read in any way alike, and appear complete, over nothing else, or not at all."""

import bz2
import errno
import gzip
import io
import lzma
import os
import shutil
import stat
import subprocess
import sys
import threading
from pathlib import Path

import lz4.frame
import pytest
from mcap.writer import Writer as McapLibraryWriter
from oracles import OFFICE, OFFICE_BAG, OFFICE_DB, OFFICE_MCAP, copy, mcap_messages
from rosbags.rosbag1 import Writer as Ros1LibraryWriter

from odomcorrupt.bags import output, pipeline
from odomcorrupt.bags.mcap.writer import ChannelTable
from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.bags.output import beside, place, sweep
from odomcorrupt.bags.pipeline import OrderedResults, Workers
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


@pytest.mark.parametrize(
    ("source", "name", "codec", "level", "words"),
    [
        (OFFICE_BAG, "a.mcap", "bz2", None, "bz2"), (OFFICE_BAG, "a.bag", "zstd", None, "zstd"),
        (OFFICE_BAG, "a.bag", "snappy", None, "snappy"), (OFFICE_MCAP, "a.mcap", "none", 3, "3: without compression"),
        (OFFICE_BAG, "a.bag", "none", 3, "3: without compression"), (OFFICE, "a", None, 3, "3: without compression"),
        (OFFICE_MCAP, "a.mcap", "zstd", 40, "level 40"),
    ],
)  # fmt: skip
def test_a_compression_or_level_that_cannot_be_is_refused(source, name, codec, level, words, tmp_path):
    with open_reader(source) as reader, pytest.raises(BagError, match=words):
        open_writer(tmp_path / name, reader, compression=codec, level=level)
    assert not any(tmp_path.iterdir())


def test_a_level_that_the_compression_of_the_input_does_not_have_leaves_nothing(tmp_path):
    with pytest.raises(BagError, match="level 40"):
        copy(OFFICE_MCAP, tmp_path / "out.mcap", level=40)
    assert not any(tmp_path.iterdir())


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


class Dribble(io.RawIOBase):
    """A pipe that gives a few bytes at a time."""

    def __init__(self, data):
        self.left = memoryview(data)

    def readable(self):
        return True

    def readinto(self, view):
        size = min(len(view), len(self.left), 7)
        view[:size] = self.left[:size]
        self.left = self.left[size:]
        return size


DATA = bytes(range(256)) * 8


def sources(tmp_path):
    (tmp_path / "data").write_bytes(DATA)
    return [
        Source.of_file(tmp_path / "data"),
        Source(io.BytesIO(DATA), "pipe"),
        Source(Dribble(DATA), "raw"),
        Source(io.BufferedReader(Dribble(DATA)), "slow"),
    ]


def test_every_way_of_reading_gives_the_same_bytes(tmp_path):
    for source in sources(tmp_path):
        assert source.sniff(16) == DATA[:16]
        assert source.sniff(4) == DATA[:4]
        assert source.read(3, "begin") == DATA[:3]
        assert source.read_array(40, "array").tobytes() == DATA[3:43]
        assert bytes(source.read_scratch(50, "scratch")) == DATA[43:93]
        assert source.position == 93
        assert not source.at_end()
        assert source.read(len(DATA) - 93, "rest") == DATA[93:]
        assert source.at_end()
        assert source.read(0, "nothing") == b""
        source.close()


@pytest.mark.parametrize("claim", [len(DATA) + 1, 2**31, 2**40, 2**63, 2**64 - 1])
@pytest.mark.parametrize("way", ["read", "read_array", "read_scratch"])
def test_a_claim_beyond_the_end_is_an_error_that_names_it(tmp_path, claim, way):
    for source in sources(tmp_path):
        source.read(4, "begin")
        with pytest.raises(BagError, match=r"the thing at byte .*recover=True"):
            getattr(source, way)(claim, "the thing")
        source.close()


def test_a_pipe_stays_open_when_the_source_closes():
    stream = io.BytesIO(DATA)
    with Source(stream, "pipe") as source:
        source.read(1, "one")
    assert not stream.closed


def test_what_is_put_behind_does_not_wait_for_ever(monkeypatch):
    monkeypatch.setattr(pipeline, "WAITING_BYTES", 10)
    go, taken = threading.Event(), []
    with Workers(2) as workers:
        results = OrderedResults(workers)
        results.put(go.wait, taken.append, 1)
        threading.Timer(0.05, go.set).start()
        for number in range(100):
            results.put(lambda number=number: number, taken.append, 1, worth=False)
            assert number + 2 - len(taken) <= 10
        results.finish()
    assert taken == [True, *range(100)]


BAGS = {"file": OFFICE_MCAP, "sqlite": OFFICE_DB, "directory": OFFICE}


def target_of(kind, tmp_path):
    return tmp_path / ("out" + BAGS[kind].suffix)


def existing(path, *, directory):
    if directory:
        path.mkdir()
        (path / "other.db3").write_text("a stranger's")
    else:
        path.write_text("a stranger's")


@pytest.fixture(params=[True, False], ids=["renameat2", "without"])
def _both_ways(request, monkeypatch):
    """Rename as Linux can, and as any system can."""
    if not request.param:
        monkeypatch.setattr(output, "_rename_flagged", lambda *_: False)


@pytest.mark.usefixtures("_both_ways")
@pytest.mark.parametrize("kind", BAGS)
def test_what_appeared_meanwhile_stays_and_nothing_is_left(kind, tmp_path):
    out = target_of(kind, tmp_path)

    def appear(_reader, _writer, block):
        if len(block.table) and not out.exists():
            existing(out, directory=kind == "directory")

    with pytest.raises(BagError, match="was written by another program in the meantime"):
        copy(BAGS[kind], out, appear)
    assert [one.name for one in tmp_path.iterdir()] == [out.name]
    assert (out / "other.db3" if out.is_dir() else out).read_text() == "a stranger's"


@pytest.mark.usefixtures("_both_ways")
@pytest.mark.parametrize("directory", [False, True])
@pytest.mark.parametrize("there", [False, True])
def test_a_complete_output_is_placed_and_what_it_replaces_hands_on_its_permissions(directory, there, tmp_path):
    out, partial = tmp_path / "out", tmp_path / "partial"
    if there:
        existing(out, directory=directory)
        out.chmod(0o750 if directory else 0o640)
    if directory:
        partial.mkdir()
        (partial / "new.db3").write_text("ours")
    else:
        partial.write_text("ours")
    place(partial, out, overwrite=True)
    assert [one.name for one in tmp_path.iterdir()] == ["out"]
    assert [one.read_text() for one in (out.iterdir() if directory else [out])] == ["ours"]
    assert not there or out.stat().st_mode & 0o777 == (0o750 if directory else 0o640)


def test_of_many_programs_with_one_new_output_one_succeeds(tmp_path):
    program = (
        "import sys, time, pathlib\nfrom odomcorrupt.bags.output import beside, place\n"
        "out = pathlib.Path(sys.argv[1]); mine = beside(out); mine.write_text(sys.argv[2]); print(flush=True)\n"
        "sys.stdin.readline()\nplace(mine, out, overwrite=False)\n"
    )
    words = [sys.executable, "-c", program, str(tmp_path / "out.mcap")]
    programs = [
        subprocess.Popen([*words, str(number)], stdin=-1, stdout=-1, stderr=subprocess.DEVNULL, text=True)
        for number in range(8)
    ]
    for one in programs:
        one.stdout.readline()
    for one in programs:
        one.stdin.write("\n")
        one.stdin.flush()
    won = [number for number, one in enumerate(programs) if one.wait() == 0]
    for one in programs:
        one.communicate()
    assert len(won) == 1
    assert (tmp_path / "out.mcap").read_text() == str(won[0])


def test_leftovers_of_dead_processes_of_this_machine_are_swept_and_only_those(tmp_path, dead):
    host = beside(tmp_path / "out.mcap").name.split(".")[3]
    left = [f".out.mcap.{host}.{dead}.0123abcd.partial", f".out.mcap.{host}.{dead}.89abcdef.partial-journal"]
    stay = [
        f".out.mcap.{host}.{os.getpid()}.0123abcd.partial",
        f".out.mcap.{'0' * 8}.{dead}.0123abcd.partial",
        f".other.mcap.{host}.{dead}.0123abcd.partial",
        f".out.mcap.{host}.{dead}.0123abcd.partially",
        ".out.mcap.partial",
        "out.partial",
    ]
    for name in (*left, *stay):
        (tmp_path / name).write_text("half")
    (tmp_path / f".out.mcap.{host}.{dead}.00000000.partial").mkdir()
    copy(OFFICE_MCAP, tmp_path / "out.mcap")
    assert sorted(one.name for one in tmp_path.iterdir()) == sorted([*stay, "out.mcap"])
    sweep(tmp_path / "nowhere")


@pytest.mark.parametrize("name", ["n" * 250 + ".mcap", "ü" * 120 + ".mcap", "[a]*?.mcap", "x.db3"])
def test_any_name_that_the_file_system_takes_can_be_written(name, tmp_path):
    source = BAGS["sqlite"] if name.endswith("db3") else OFFICE_MCAP
    copy(source, tmp_path / name)
    assert [one.name for one in tmp_path.iterdir()] == [name]


@pytest.mark.parametrize("name", ["out.mcap", "out", "deeper/out.mcap", "office_ros2.db3"])
def test_an_output_inside_of_the_input_is_refused(name, tmp_path):
    source = tmp_path / "bag"
    (source / "deeper").mkdir(parents=True)
    for file in BAGS["directory"].iterdir():
        (source / file.name).write_bytes(file.read_bytes())
    (tmp_path / "link").symlink_to(source)
    before = sorted(source.rglob("*"))
    for path in (source, tmp_path / "link"):
        with pytest.raises(BagError, match=r"(lies in|is) the input"):
            copy(source, path / name, overwrite=True)
    assert sorted(source.rglob("*")) == before


def test_an_error_of_the_file_system_is_reported_and_nothing_is_left(tmp_path, monkeypatch):
    def fail(*_args):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(output, "_rename_flagged", fail)
    with pytest.raises(BagError, match="Read-only file system"):
        copy(OFFICE_MCAP, tmp_path / "out.mcap")
    assert list(tmp_path.iterdir()) == []


def test_a_link_is_written_through(tmp_path):
    (tmp_path / "real").mkdir()
    (tmp_path / "out.mcap").symlink_to(Path("real") / "out.mcap")
    for _ in ("to nothing", "to what is replaced"):
        copy(OFFICE_MCAP, tmp_path / "out.mcap", overwrite=True)
        assert (tmp_path / "out.mcap").is_symlink()
        assert (tmp_path / "real" / "out.mcap").read_bytes().startswith(b"\x89MCAP")
        (tmp_path / "real" / "out.mcap").write_text("older")

"""Damage, undecodable messages, bad luck, half a minute of fuzz: one line, the right exit code, nothing left behind."""

import contextlib
import io
import os
import random
import re
import resource
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import time
import zlib
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import zstandard
from bagged import messages_in, rows_of
from crash import rewrites
from fuzz import Fuzz
from mutations import mcap_records
from reader_fuzz import ReaderFuzz
from smallbags import make_small_bags

from odomcorrupt.bags.messages import gather, locate, scatter
from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.cli import run
from recordings import FIXTURES, OFFICE

OURS = [sys.executable, "-m", "odomcorrupt"]
NOBODY = 65534


def call(*words, limit=None, stdin=subprocess.DEVNULL):
    """Run the program, in a process of its own where a resource (its name, most) is limited; return code and stderr."""
    if limit is None:
        with contextlib.redirect_stderr(io.StringIO()) as said, contextlib.redirect_stdout(io.StringIO()):
            code = run([str(word) for word in words])
        return code, said.getvalue()

    def limited():
        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(limit[0], (limit[1], limit[1]))

    done = subprocess.run(
        [sys.executable, "-B", *OURS[1:], *map(str, words)],  # bytecode would be cut at the limit, and read later
        stdin=stdin, capture_output=True, text=True, timeout=60, check=False, preexec_fn=limited,
    )  # fmt: skip
    return done.returncode, done.stderr


def laid(tmp_path, data, name="in.mcap"):
    """Put a damaged bag into a directory of its own, and give the output another."""
    (tmp_path / "in").mkdir(exist_ok=True)
    (tmp_path / "out").mkdir(exist_ok=True)
    source = tmp_path / "in" / name
    source.write_bytes(data)
    return source, tmp_path / "out" / name


def refused(source, target, *words, **options):
    """Expect a failure in one line that leaves all as it was; return the line."""
    before, stamp = source.read_bytes(), source.stat().st_mtime_ns
    code, said = call(source, target, "--seed", "7", *words, **options)
    assert (code, said.count("\n"), said[:13]) == (1, 1, "odomcorrupt: "), said
    assert (source.read_bytes(), source.stat().st_mtime_ns) == (before, stamp)
    assert not list(target.parent.iterdir())
    assert [one.name for one in source.parent.iterdir()] == [source.name]
    return said


def chunk_of(size, data, *, crc=0, name=b"zstd"):
    content = struct.pack("<QQQII", 0, 0, size, crc, len(name)) + name + struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", 6, len(content)) + content


def bomb(size):
    """A small frame that unpacks to `size` zeros, and says so only as it goes."""
    packer = zstandard.ZstdCompressor(level=1).compressobj()
    piece = bytes(1 << 24)
    return b"".join(packer.compress(piece) for _ in range(size >> 24)) + packer.flush()


@pytest.mark.parametrize(
    ("chunk", "words"),
    [
        (lambda: chunk_of(1 << 42, b"\x28\xb5\x2f\xfd\x00\x00"), "states that it unpacks to 4398046511104 bytes"),
        (lambda: chunk_of(1 << 29, bomb(1 << 24)), "a ratio that no recording has"),
        (lambda: chunk_of(1000, bomb(1 << 30)), "but unpacks to "),
        (lambda: chunk_of((1 << 30) + 1, bomb(1 << 24)), "more than the 1073741824 that a chunk may"),
        (lambda: chunk_of(9, zstandard.compress(b"\x05" + (2**63).to_bytes(8, "little"))), "does not fit its 9 bytes"),
        (lambda: chunk_of(4, zstandard.compress(b"abcd"), crc=zlib.crc32(b"abce")), "checksum does not match"),
    ],
    ids=["claims terabytes", "claims more", "unpacks to more", "too large", "lying record", "checksum"],
)
def test_a_chunk_that_lies_is_refused_before_it_takes_memory(chunk, words, bags, tmp_path):
    data = bags["mcap zstd"].path.read_bytes()
    begin, end = next((begin, end) for opcode, begin, end in mcap_records(data) if opcode == 6)
    # the footer, whose numbers would be wrong, tells of no summary
    source, target = laid(tmp_path, data[:begin] + chunk() + data[end:-28] + bytes(20) + data[-8:])
    assert words in refused(source, target, limit=(resource.RLIMIT_AS, 1_500 << 20))


def test_a_wrong_definition_is_carried_and_a_wrong_type_is_reported(bags, tmp_path):
    data = bags["mcap none"].path.read_bytes()
    garbled = data.replace(b"float64[36] covariance", b"float64[99] covariance")
    assert garbled != data
    # the definition's checksum stands in its chunk's: none
    code, said = call(*laid(tmp_path, _without_checksums(garbled)), "--seed", "7")
    assert code == 0, said


def test_a_quaternion_of_another_length_turns_by_as_much(bags, tmp_path):
    source, stretched = bags["mcap zstd"].path, tmp_path / "in.mcap"
    with open_reader(source) as reader, open_writer(stretched, reader) as writer:
        (odom,) = (channel for channel in reader.channels.values() if channel.topic == "/odom")
        for block in reader.blocks():
            for layout in locate(block, odom):
                values = gather(block, layout, layout.items[0], "orientation")
                scatter(block, layout, layout.items[0], "orientation", 3.0 * values)
            writer.write(block)
    for path in (stretched, source):
        assert call(path, tmp_path / f"out_{path.name}", "--seed", "7")[0] == 0
    three, one = (rows_of(tmp_path / f"out_{path.name}") for path in (stretched, source))
    np.testing.assert_allclose(three.position, one.position, atol=1e-12)
    length = np.linalg.norm(three.orientation, axis=1, keepdims=True)
    np.testing.assert_allclose(three.orientation / length, one.orientation, atol=1e-12)


def _without_checksums(data):
    out = bytearray(data)
    for opcode, begin, end in mcap_records(data):
        if opcode == 6:
            out[begin + 33 : begin + 37] = bytes(4)
        elif opcode == 15:
            out[begin + 9 : begin + 13] = bytes(4)
        elif opcode == 2:
            out[end - 4 : end] = bytes(4)
    return bytes(out)


@pytest.mark.parametrize("kind", ["mcap zstd", "ros1 lz4", "sqlite3 file", "sqlite3 directory", "mcap directory"])
def test_a_full_disk_is_said_and_leaves_nothing(kind, bags, tmp_path):
    source = bags[kind].path
    code, said = call(source, tmp_path / source.name, "--seed", "7", limit=(resource.RLIMIT_FSIZE, 6000))
    assert (code, said.count("\n")) == (1, 1), said
    assert "cannot be written" in said or "sqlite3 reports" in said
    assert not list(tmp_path.iterdir())


@pytest.fixture
def room():
    """Yield a directory that every user can reach."""
    with tempfile.TemporaryDirectory() as made:
        Path(made).chmod(0o755)
        yield Path(made)


def as_nobody(*words):
    """Run a command without the rights of root, in a fork: not every user may run our Python; return code and words."""
    seen, told = os.pipe()
    child = os.fork()
    if child == 0:
        code = 99
        with contextlib.suppress(BaseException), os.fdopen(told, "w") as stream:
            if os.getuid() == 0:
                os.setgid(NOBODY)
                os.setuid(NOBODY)
            with contextlib.redirect_stderr(stream):
                code = run([str(word) for word in words])
        os._exit(code)
    os.close(told)
    with os.fdopen(seen) as stream:
        said = stream.read()
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]), said


@pytest.mark.parametrize(
    ("forbidden", "kind"),
    [*(("writing", kind) for kind in ("mcap zstd", "ros1 lz4", "sqlite3 file", "sqlite3 directory")),
     *(("reading", kind) for kind in ("mcap zstd", "ros1 lz4", "sqlite3 file"))],
)  # fmt: skip
def test_what_may_not_be_read_or_written_is_said(forbidden, kind, bags, room, tmp_path):
    source, folder = room / bags[kind].path.name, room / "folder"
    shutil.copytree(bags[kind].path, source) if bags[kind].path.is_dir() else shutil.copyfile(bags[kind].path, source)
    # all imports are done before the rights are gone
    assert run([str(source), str(tmp_path / source.name), "--seed", "7"]) == 0
    folder.mkdir(mode=0o555)
    if forbidden == "reading":
        source.chmod(0)
        folder.chmod(0o777)
    code, said = as_nobody(source, folder / source.name, "--seed", "7")
    assert (code, said.count("\n")) == (1, 1), said
    assert "Permission denied" in said or (forbidden == "writing" and "unable to open" in said)
    assert not list(folder.iterdir())


def test_a_directory_that_vanishes_meanwhile_is_said(bags, tmp_path):
    room = tmp_path / "room"
    room.mkdir()
    fifo = tmp_path / "slow.mcap"
    os.mkfifo(fifo)
    data = bags["mcap zstd"].path.read_bytes()
    process = subprocess.Popen(
        [*OURS, str(fifo), str(room / "out.mcap"), "--seed", "7", "--odom-topic", "/odom"], stderr=subprocess.PIPE
    )
    with fifo.open("wb") as stream:
        stream.write(data[:1000])
        stream.flush()
        deadline = time.monotonic() + 30
        while not list(room.iterdir()) and time.monotonic() < deadline:
            time.sleep(0.01)
        for left in room.iterdir():
            left.unlink()
        room.rmdir()
        stream.write(data[1000:])
    _, said = process.communicate(timeout=60)
    assert process.returncode == 1
    assert said.decode().startswith(f"odomcorrupt: {room / 'out.mcap'}: cannot be written: No such file"), said
    assert said.count(b"\n") == 1


@pytest.mark.parametrize(
    ("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143), (signal.SIGHUP, 129), (signal.SIGKILL, None)]
)
def test_a_signal_leaves_no_output_and_what_was_there(number, code, bags, tmp_path, interruptible):
    target = tmp_path / "out.mcap"
    target.write_bytes(b"what was there")
    data = bags["mcap zstd"].path.read_bytes()
    words = [*OURS, "-", str(target), "--seed", "7", "--odom-topic", "/odom", "--overwrite"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdin.write(data[: len(data) // 2])
        process.stdin.flush()
        deadline = time.monotonic() + 30
        while len(list(tmp_path.iterdir())) < 2 and time.monotonic() < deadline:
            time.sleep(0.01)
        process.send_signal(number)
        assert process.wait(timeout=30) == (-number if code is None else code)
        said = process.stderr.read()
    assert target.read_bytes() == b"what was there"
    assert b"Traceback" not in said
    if code is not None:
        assert [one.name for one in tmp_path.iterdir()] == ["out.mcap"]


def test_a_signal_within_a_callback_is_not_lost():
    code = (
        "import os, sys, weakref; from odomcorrupt import cli; "
        "cli.run = lambda _: (weakref.finalize(set(), os.kill, os.getpid(), 1), sys.stdin.read()); cli.main()"
    )
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert (process.wait(timeout=30), process.stderr.read()) == (129, b"")


PLACES = {"mcap zstd": (0.25, 0.35), "mcap unchunked": (0.4, 0.6), "ros1 none": (0.4, 0.5), "sqlite3 file": (0.6, 0.8)}
"""Parts of a small bag before which its messages lie."""


@pytest.mark.parametrize(("kind", "place"), [(kind, place) for kind, places in PLACES.items() for place in places])
def test_recovery_tells_what_it_lost_and_exits_with_3(kind, place, bags, tmp_path):
    data = bytearray(bags[kind].path.read_bytes())
    page = 4096 if kind == "sqlite3 file" else 1
    at = int(place * len(data)) // page * page
    data[at : at + 4096] = b"\xff" * 4096
    source, target = laid(tmp_path, bytes(data), f"in{bags[kind].path.suffix}")
    assert "--recover" in refused(source, target)
    code, said = call(source, target, "--seed", "7", "--recover")
    assert code == 3, said
    assert target.exists()
    assert "--recover" not in said
    with open_reader(target) as reader:
        saved = sum(len(block.table) for block in reader.blocks())
    assert 0.3 * bags[kind].count < saved < bags[kind].count


@pytest.mark.parametrize("data", [b"\x89MCAP0\r\n", b"#ROSBAG V2.0\n", b"SQLite format 3\0", b"", b"nothing"])
def test_what_cannot_be_recovered_is_not_advised_to_recover(data, tmp_path):
    source, target = laid(tmp_path, data)
    assert "--recover" not in refused(source, target, "--recover")


@pytest.mark.parametrize("most", [12, 16])
def test_a_batch_with_few_descriptors_ends_and_says_why(most, tmp_path):
    words = ["batch", OFFICE, tmp_path / "runs", "--runs", "3", "--jobs", "2", "--seed", "1", "-q"]
    code, said = call(*words, limit=(resource.RLIMIT_NOFILE, most))
    assert (code, said.count("\n")) in ((0, 0), (1, 1)), said
    if code:
        assert said.startswith("odomcorrupt: ")
        assert "Too many open files" in said


@pytest.mark.parametrize("how", ["pipe recovered", "pipe learned", "cut database"])
def test_a_disk_that_is_full_is_named_as_such(how, tmp_path):
    cut = tmp_path / "cut.db3"
    shutil.copyfile(FIXTURES / "office_ros2" / "office_ros2.db3", cut)
    with cut.open("r+b") as stream:
        stream.truncate(cut.stat().st_size - 100)
    words = {
        "pipe recovered": ["-", tmp_path / "out.mcap", "--odom", "/odom", "--recover"],
        "pipe learned": ["learn", "-"],
        "cut database": ["info", cut, "--recover"],
    }[how]
    with OFFICE.open("rb") as stdin:
        code, said = call(*words, limit=(resource.RLIMIT_FSIZE, 100_000), stdin=stdin)
    assert (code, said.count("\n")) == (1, 1)
    assert "cannot be " in said
    assert "damaged" not in said
    assert "--help" not in said
    assert not list(tmp_path.glob("*out*"))


@pytest.mark.slow
def test_killed_at_any_moment_nothing_half_stands_under_a_name(tmp_path):
    said = rewrites(tmp_path, 8, random.Random(2))  # noqa: S311 - moments, no secrets
    assert said.startswith("8 ")


KINDS = (
    "mcap zstd", "mcap none", "mcap unchunked", "mcap of ros1", "mcap directory", "ros1 none", "ros1 bz2",
    "sqlite3 file", "sqlite3 directory",
)  # fmt: skip
DAMAGED = {"/odom": {3, 4, 11}, "/tf": {0, 9}}
"""Which messages of a topic are damaged, by their order."""


def damaged(source, target, damage=DAMAGED, compression=None):
    """Copy a bag, all of whose checksums are true, with the length of the first string of some messages changed."""
    seen = dict.fromkeys(damage, 0)
    with open_reader(source) as reader, open_writer(target, reader, compression=compression) as writer:
        for block in reader.blocks():
            for channel in reader.channels.values():
                for layout in locate(block, channel) if channel.topic in damage else ():
                    for start in layout.starts:
                        if seen[channel.topic] in damage[channel.topic]:
                            at = start + layout.items[0].stamp + 8  # in what a frame's length is
                            block.data[at : at + 4] = np.frombuffer(b"\xff\xff\xff\x7f", dtype=np.uint8)
                        seen[channel.topic] += 1
            writer.write(block)
    return target


def without_damaged(everything, damage=DAMAGED):
    of_topic = Counter()
    kept = []
    for message in everything:
        if of_topic[message[0]] not in damage.get(message[0], ()):
            kept.append(message)
        of_topic[message[0]] += 1
    return kept


@pytest.mark.parametrize("compression", [None, "message"])
@pytest.mark.parametrize("kind", KINDS)
def test_they_are_left_out_alone_and_counted_by_topic(kind, compression, bags, tmp_path):
    source = bags[kind].path
    if compression and not source.is_dir():
        pytest.skip("only the messages of a directory are compressed one by one")
    bad = damaged(source, tmp_path / ("bad" + source.suffix), compression=compression)
    out = tmp_path / ("out" + source.suffix)
    code, said = call(bad, out, "--seed", "7")
    assert (code, said.count("\n"), said[:13]) == (1, 1, "odomcorrupt: "), said
    assert "--recover leaves such messages out" in said
    assert not out.exists()

    code, said = call(bad, out, "--seed", "7", "--recover", "-v")
    assert code == 3, said
    lost = Counter()
    for count, topic in re.findall(r"(\d+) of the messages of (\S+) cannot be decoded: left out", said):
        lost[topic] += int(count)
    assert lost == {topic: len(places) for topic, places in DAMAGED.items()}
    files = len(list(bad.glob("*.mcap"))) if bad.is_dir() else 1
    assert said.count("Lost: ") <= 2 * max(files, 1)
    saved = messages_in(out)
    expected = without_damaged(messages_in(source))
    assert [one[:2] for one in saved] == [one[:2] for one in expected]
    untouched = [one for one in expected if one[0] not in DAMAGED]
    assert [one for one in saved if one[0] not in DAMAGED] == untouched
    assert call("info", out)[0] == 0


@pytest.mark.parametrize("kind", ["mcap zstd", "ros1 none", "sqlite3 file"])
def test_each_is_read_by_other_formats_too(kind, bags, tmp_path):
    bad = damaged(bags[kind].path, tmp_path / ("bad" + bags[kind].path.suffix))
    out = tmp_path / "out.mcap"
    assert call(bad, out, "--seed", "7", "--recover")[0] == 3
    assert len(messages_in(out)) == bags[kind].count - sum(map(len, DAMAGED.values()))


@pytest.mark.parametrize("kind", ["mcap zstd", "ros1 none", "sqlite3 file"])
def test_what_is_not_corrupted_is_left_out_too_so_that_the_output_can_be_studied(kind, bags, tmp_path):
    source = bags[kind].path
    damage = {"/imu": {1, 2}}
    bad = damaged(source, tmp_path / ("bad" + source.suffix), damage)
    assert call(bad, tmp_path / ("whole" + source.suffix), "--seed", "7")[0] == 0
    out = tmp_path / ("out" + source.suffix)
    code, said = call(bad, out, "--seed", "7", "--recover")
    assert code == 3, said
    assert "LOST" in said
    assert "2 of the messages of /imu cannot be" in " ".join(said.split())
    assert [one for one in messages_in(out) if one[0] == "/imu"] == [
        one for one in without_damaged(messages_in(source), damage) if one[0] == "/imu"
    ]


def test_an_encoding_that_is_not_read_is_not_damage(bags, tmp_path):
    source = bags["mcap zstd"].path
    parameters = tmp_path / "parameters.mcap"
    with open_reader(source) as reader, open_writer(parameters, reader) as writer:
        for block in reader.blocks():
            imu = next((one.id for one in reader.channels.values() if one.topic == "/imu"), -1)
            for start in block.table["offset"][block.table["channel"] == imu]:
                block.data[start + 1] = 3  # a parameter list
            writer.write(block)
    out = tmp_path / "out.mcap"
    assert call(parameters, out, "--seed", "7", "--recover")[0] == 0
    assert len(messages_in(out)) == bags["mcap zstd"].count


def test_info_counts_them(bags, tmp_path):
    bad = damaged(bags["ros1 none"].path, tmp_path / "bad.bag")
    code, said = call("info", bad, "--recover")
    assert (code, said.count("Lost: ")) == (3, 2)
    assert "3 of the messages of /odom" in said


FUZZED = (
    "mcap zstd", "mcap lz4", "mcap none", "mcap unchunked", "mcap of ros1", "mcap directory", "ros1 bz2", "ros1 lz4",
    "ros1 none", "sqlite3 file", "sqlite3 directory", "model file", "map .yaml", "map .pgm", "CSV", "TUM",
)  # fmt: skip
CASES = 40
SECONDS = 2


@pytest.fixture(scope="module")
def fuzz(tmp_path_factory):
    return Fuzz(tmp_path_factory.mktemp("fuzz"), 0)


def test_every_kind_is_tried(fuzz):
    assert set(fuzz.kinds) == set(FUZZED)


@pytest.mark.slow
@pytest.mark.parametrize("kind", FUZZED)
def test_damage_is_refused_in_a_line_or_changes_nothing_that_is_not_reported(fuzz, kind):
    begun = time.monotonic()
    number = 0
    while number < CASES and (number < CASES // 5 or time.monotonic() - begun < SECONDS):
        fuzz.case(kind, number)
        number += 1


def test_small_bags_are_the_same_every_time(tmp_path):
    for name in ("one", "two"):
        (tmp_path / name).mkdir()
    one, two = (make_small_bags(tmp_path / name) for name in ("one", "two"))
    for kind, small in one.items():
        if small.path.is_file() and small.path.suffix != ".db3":
            assert small.path.read_bytes() == two[kind].path.read_bytes()
        assert small.count == two[kind].count > 50


def test_damage_in_memory_is_refused_or_read_alike_in_every_way(tmp_path):
    readers, begun, number = ReaderFuzz(tmp_path, 0), time.monotonic(), 0
    while number < 20 or (number < 200 and time.monotonic() - begun < 1.0):
        for kind in readers.kinds:
            readers.case(kind, number)
        number += 1
    assert sum(readers.counts.values()) == number * len(readers.kinds)
    assert {name.rpartition(": ")[2] for name in readers.counts} == {"read", "refused", "recovered"}

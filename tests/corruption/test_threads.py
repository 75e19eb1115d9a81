"""However many threads there are: the same bytes, the same errors, and nothing left over."""

import os
import resource
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from drives import model
from mcap.writer import CompressionType, Writer
from test_run import bytes_of

from odomcorrupt.bags.open import open_reader
from odomcorrupt.cli import run
from odomcorrupt.corruption.run import Container, corrupt_bag
from odomcorrupt.corruption.transform import Options
from odomcorrupt.errors import BagError

FIXTURES = Path(__file__).parent.parent.parent / "fixtures"
COMMAND = [sys.executable, "-m", "odomcorrupt"]


def corrupt(source, target, threads, **container):
    corrupt_bag(
        source, target, model(), seed=3, run=0, options=Options(), container=Container(threads=threads, **container)
    )
    return bytes_of(target)


@pytest.fixture(scope="module")
def long(tmp_path_factory):
    """Return a bag of 60 MB: the fixture's messages, and others between them that do not compress."""
    path = tmp_path_factory.mktemp("long") / "long.mcap"
    rng = np.random.default_rng(1)
    with path.open("wb") as stream, open_reader(FIXTURES / "office.mcap") as reader:
        writer = Writer(stream, chunk_size=1 << 20, compression=CompressionType.ZSTD)
        writer.start("ros2", "test")
        ids = {}
        for channel in reader.channels.values():
            definition = reader.definition(channel)
            schema = writer.register_schema(definition.name, definition.encoding, definition.text)
            ids[channel.id] = writer.register_channel(channel.topic, channel.encoding, schema)
        noise = writer.register_channel("/noise", "raw", 0)
        number = 0
        for block in reader.blocks():
            for channel, log_ns, offset, length in block.table.tolist():
                data = block.data[offset : offset + length].tobytes()
                writer.add_message(ids[channel], log_ns, data, log_ns)
                number += 1
                if number % 20 == 0:
                    writer.add_message(noise, log_ns, rng.bytes(50_000), log_ns)
        writer.finish()
    assert path.stat().st_size > 20 << 20
    return path


@pytest.mark.parametrize("name", ["office.bag", "office.mcap", "office_ros2"])
@pytest.mark.parametrize("compression", [None, "none", "lz4"])
def test_the_bytes_of_every_format_are_the_same(name, compression, tmp_path):
    if name == "office_ros2" and compression == "lz4":
        pytest.skip("sqlite3 has no compression")
    made = [corrupt(FIXTURES / name, tmp_path / str(n) / name, n, compression=compression) for n in _rooms(tmp_path)]
    assert made[0] == made[1] == made[2]


def _rooms(tmp_path):
    for threads in (1, 2, 5):
        (tmp_path / str(threads)).mkdir()
        yield threads


@pytest.mark.parametrize("compression", [None, "none"])
def test_the_bytes_of_a_long_bag_are_the_same_from_a_pipe_too(long, compression, tmp_path):
    made = [corrupt(long, tmp_path / str(n) / "out.mcap", n, compression=compression) for n in _rooms(tmp_path)]
    assert made[0] == made[1] == made[2]
    more = [] if compression is None else ["--compression", compression]
    with long.open("rb") as source, (tmp_path / "piped.mcap").open("wb") as target:
        words = [*COMMAND, "-", "-", "--odom-topic", "/odom", "--seed", "3", "--threads", "3", *more]
        subprocess.run(words, stdin=source, stdout=target, check=True, stderr=subprocess.DEVNULL)
    words = [str(long), str(tmp_path / "alone.mcap"), "--seed", "3", "--threads", "1", *more]
    assert run(words) == 0
    assert (tmp_path / "piped.mcap").read_bytes() == (tmp_path / "alone.mcap").read_bytes()


@pytest.mark.parametrize("place", [0.3, 0.9])
def test_damage_is_reported_in_the_same_words_and_nothing_stays(long, place, tmp_path):
    data = bytearray(long.read_bytes())
    at = int(len(data) * place)
    data[at : at + 100] = bytes(100)
    (tmp_path / "damaged.mcap").write_bytes(data)
    told = set()
    for threads in (1, 2, 4):
        with pytest.raises(BagError) as caught:
            corrupt(tmp_path / "damaged.mcap", tmp_path / "out.mcap", threads)
        told.add(str(caught.value))
    assert len(told) == 1
    assert [file.name for file in tmp_path.iterdir()] == ["damaged.mcap"]
    assert threading.active_count() == 1


def test_what_is_lost_of_a_damaged_bag_is_the_same(long, tmp_path):
    data = bytearray(long.read_bytes())
    at = len(data) // 2
    data[at : at + 100] = bytes(100)
    (tmp_path / "damaged.mcap").write_bytes(data)
    made = [corrupt(tmp_path / "damaged.mcap", tmp_path / f"{n}.mcap", n, recover=True) for n in (1, 3)]
    assert [*made[0].values()] == [*made[1].values()]


def _limited():
    resource.setrlimit(resource.RLIMIT_FSIZE, (10 << 20, 10 << 20))
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)


@pytest.mark.parametrize("threads", ["1", "3"])
def test_a_full_disk_ends_everything_with_one_line_and_nothing_stays(long, threads, tmp_path):
    words = [*COMMAND, long, tmp_path / "out.mcap", "--seed", "1", "--threads", threads]
    done = subprocess.run(words, capture_output=True, text=True, preexec_fn=_limited, timeout=60, check=False)
    assert done.returncode == 1
    assert done.stderr.count("\n") == 1
    assert "cannot be written: File too large" in done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_everything_at_once_though_a_pipe_waits(long, number, tmp_path):
    out = tmp_path / "out.mcap"
    words = [*COMMAND, "-", str(out), "--odom-topic", "/odom", "--seed", "1", "--threads", "3"]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        process.stdin.write(long.read_bytes()[: 20 << 20])
        process.stdin.flush()
        _wait_for(lambda: list(tmp_path.iterdir()))
        time.sleep(0.3)
        process.send_signal(number)
        begun = time.monotonic()
        assert process.wait(20) in (130, 128 + number)
        assert time.monotonic() - begun < 10
        assert process.stderr.read().strip().count(b"\n") == 0  # behind the ^C of a terminal
    assert not list(tmp_path.iterdir())


@pytest.mark.usefixtures("interruptible")
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupt_ends_everything_though_nobody_reads_what_is_written(long, number, tmp_path):
    words = [*COMMAND, str(long), "-", "--seed", "1", "--threads", "3"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        os.read(process.stdout.fileno(), 1000)
        time.sleep(0.3)
        process.send_signal(number)
        assert process.wait(20) in (130, 128 + number)


def _wait_for(condition):
    end = time.monotonic() + 20
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)

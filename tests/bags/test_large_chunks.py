"""A chunk too large to be held is read as several: the same messages, the same errors, in bounded memory."""

import bz2
import io
import re
import struct
import subprocess
import sys
import zlib
from itertools import pairwise
from pathlib import Path

import lz4.frame
import pytest
import zstandard
from oracles import (
    OFFICE_BAG,
    OFFICE_MCAP,
    copy,
    mcap_messages,
    mcap_record,
    mcap_record_places,
    office_variant,
    pipe_of,
    ros1_messages,
)
from test_recover import recover
from test_ros1 import packed, rebuilt, records

from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.bags.pipeline import Workers
from odomcorrupt.errors import BagError

KINDS = [("mcap", "none"), ("mcap", "zstd"), ("mcap", "lz4"), ("bag", "none"), ("bag", "lz4"), ("bag", "bz2")]
SEEN = {"mcap": mcap_messages, "bag": lambda path: sorted(ros1_messages(path))}
PACK = {
    "none": bytes,
    "zstd": zstandard.ZstdCompressor(write_content_size=False, write_checksum=True).compress,
    "lz4": lambda data: lz4.frame.compress(data, block_linked=False, content_checksum=True, store_size=False),
    "bz2": lambda data: bz2.compress(data, 1),
}


@pytest.fixture
def small(monkeypatch):
    """Let chunks beyond 50 kB be large ones, read in blocks of 20 kB."""
    monkeypatch.setattr("odomcorrupt.bags.chunk._BLOCK_BYTES", 20_000)
    monkeypatch.setattr("odomcorrupt.bags.codecs._PIECE_BYTES", 7_000)
    monkeypatch.setattr("odomcorrupt.bags.chunk.LARGE_BYTES", 50_000)


def mcap_of(codec, data, crc):
    """Return an MCAP of one chunk of these records."""
    name, small = b"" if codec == "none" else codec.encode(), PACK[codec](data)
    head = struct.pack("<QQQII", 0, 0, len(data), crc, len(name)) + name + struct.pack("<Q", len(small))
    ends = mcap_record(15, bytes(4)) + mcap_record(2, bytes(20))
    return b"\x89MCAP0\r\n" + mcap_record(1, bytes(8)) + mcap_record(6, head, small) + ends + b"\x89MCAP0\r\n"


def everything(kind, source):
    """Return the office's messages: of a bag written here, which has no message indexes, rosbags reads none."""
    return SEEN[kind](source if kind == "mcap" else OFFICE_BAG)


def in_one_chunk(kind, codec, path, change=bytes, crc=None):
    """Write the office's messages as one chunk, with its records changed but not their checksum; return the path."""
    if kind == "mcap":
        data = office_variant(path, use_chunking=False).read_bytes()
        inside = b"".join(data[begin:end] for opcode, begin, end in mcap_record_places(data) if opcode in (3, 4, 5))
        path.write_bytes(mcap_of(codec, change(inside), zlib.crc32(inside) if crc is None else crc))
        return path
    found = records(copy(OFFICE_BAG, path, compression="none").read_bytes())
    inside = change(b"".join(content for fields, _, content in found if fields["op"] == b"\x05"))
    fields = {"compression": codec.encode(), "op": b"\x05", "size": struct.pack("<I", len(inside))}
    rest = [one for one in found[1:] if one[0]["op"] in (b"\x06", b"\x07")]
    index = {"conn": bytes(4), "count": bytes(4), "op": b"\x04", "ver": b"\1\0\0\0"}  # lists nothing
    return rebuilt(path, [found[0], (fields, fields, PACK[codec](inside)), (index, index, b""), *rest])


@pytest.mark.slow
@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(("kind", "codec"), KINDS)
def test_the_messages_are_the_same_in_several_chunks_for_any_threads_and_through_a_pipe(kind, codec, tmp_path):
    source = in_one_chunk(kind, codec, tmp_path / f"in.{kind}")
    out = copy(source, tmp_path / f"out.{kind}")
    assert SEEN[kind](out) == everything(kind, source)
    if kind == "mcap":
        assert sorted(mcap_messages(out, seek=True)) == sorted(mcap_messages(source))
        assert sum(opcode == 6 for opcode, *_ in mcap_record_places(out.read_bytes())) > 20
        piped = copy(None, tmp_path / "piped.mcap", stdin=pipe_of(source.read_bytes()))
    else:
        assert sum(fields["op"] == b"\x05" for fields, *_ in records(out.read_bytes())) > 20
        piped = copy(None, tmp_path / "piped.bag", stdin=pipe_of(source.read_bytes()))
    assert piped.read_bytes() == out.read_bytes()
    threaded = tmp_path / f"threaded.{kind}"
    with Workers(3) as workers, open_reader(source) as reader, open_writer(threaded, reader, workers=workers) as writer:
        for block in reader.blocks():
            writer.write(block)
    assert threaded.read_bytes() == out.read_bytes()
    saved = tmp_path / f"saved.{kind}"
    assert recover(source, saved) == []
    assert SEEN[kind](saved) == everything(kind, source)


def flipped(data):
    """Flip a bit in the middle, in what is neither a length nor a channel of any record there."""
    changed = bytearray(data)
    changed[data.index(b"base_link", len(data) // 2)] ^= 1
    return bytes(changed)


@pytest.mark.slow
@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("codec", ["none", "zstd", "lz4"])
@pytest.mark.parametrize("piped", [False, True])
def test_a_wrong_checksum_is_a_line_and_recovery_leaves_the_chunk_out(codec, piped, tmp_path):
    data = in_one_chunk("mcap", codec, tmp_path / "in.mcap", flipped).read_bytes()
    source, stdin = (None, pipe_of(data)) if piped else (tmp_path / "in.mcap", None)
    before = set(tmp_path.iterdir())
    with pytest.raises(BagError, match="its checksum does not match its bytes"):
        copy(source, tmp_path / "out.mcap", stdin=stdin)
    assert set(tmp_path.iterdir()) == before
    losses = recover(source, tmp_path / "out.mcap", io.BytesIO(data) if piped else None)
    assert "its checksum does not match its bytes" in losses[0]
    assert mcap_messages(tmp_path / "out.mcap") == []


@pytest.mark.slow
@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(("kind", "codec"), KINDS)
def test_a_chunk_that_is_damaged_or_cut_in_the_middle_is_an_error_that_leaves_nothing(kind, codec, tmp_path):
    source = in_one_chunk(kind, codec, tmp_path / f"in.{kind}")
    whole, all_messages = source.read_bytes(), everything(kind, source)
    for damaged in (whole[: len(whole) // 2], whole[: len(whole) // 2] + bytes(500) + whole[len(whole) // 2 + 500 :]):
        source.write_bytes(damaged)
        with pytest.raises(BagError, match=re.escape(str(source))) as caught:
            copy(source, tmp_path / f"out.{kind}")
        assert "\n" not in str(caught.value)
        assert set(tmp_path.iterdir()) == {source}
    source.write_bytes(whole[: len(whole) // 2])
    assert "truncated in a chunk" in recover(source, tmp_path / f"out.{kind}")[0]
    saved = SEEN[kind](tmp_path / f"out.{kind}")
    assert set(saved) < set(all_messages)
    assert 0.3 * len(all_messages) < len(saved) < 0.7 * len(all_messages)


@pytest.mark.slow
@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("kind", ["mcap", "bag"])
def test_without_a_checksum_recovery_keeps_the_messages_before_the_first_record_that_does_not_fit(kind, tmp_path):
    def harmed(data):
        """Let a message in the middle claim to be longer than the chunk."""
        at = 0
        while at < len(data) // 2:
            size = 9 + struct.unpack_from("<Q", data, at + 1)[0] if kind == "mcap" else size_of_ros1(data, at)
            at += size
        place = at + 1 if kind == "mcap" else at + 4 + struct.unpack_from("<I", data, at)[0]
        return data[:place] + b"\xff\xff\xff\x7f" + data[place + 4 :]

    all_messages = everything(kind, in_one_chunk(kind, "none", tmp_path / f"whole.{kind}"))
    source = in_one_chunk(kind, "lz4", tmp_path / f"in.{kind}", harmed, crc=0)
    with pytest.raises(BagError, match="does not fit"):
        copy(source, tmp_path / f"out.{kind}")
    assert any("does not fit" in loss for loss in recover(source, tmp_path / f"out.{kind}"))
    saved = SEEN[kind](tmp_path / f"out.{kind}")
    assert set(saved) < set(all_messages)
    assert 0.4 * len(all_messages) < len(saved) < 0.6 * len(all_messages)


def size_of_ros1(data, at):
    (header,) = struct.unpack_from("<I", data, at)
    return 8 + header + struct.unpack_from("<I", data, at + 4 + header)[0]


MB = 1 << 20
PEAK = r"""
import re, sys
from pathlib import Path
from odomcorrupt.cli import run
code = run([*sys.argv[1:], "--alpha", "0.1", "0.1", "0.1", "0.1", "--seed", "1", "--odom-topic", "/odom"])
# not what getrusage says: that includes the process this one was started by
print(code, int(re.search(r"VmHWM:\s*(\d+)", Path("/proc/self/status").read_text())[1]) // 1024, file=sys.stderr)
"""


def with_zeros(kind):
    """Return a change that puts 100 messages of 1 MB of zeros between a chunk's records."""

    def change(data):
        at, ends = 0, []
        while at < len(data):
            at += 9 + struct.unpack_from("<Q", data, at + 1)[0] if kind == "mcap" else size_of_ros1(data, at)
            ends.append(at)
        if kind == "mcap":
            schemas = mcap_record(4, struct.pack("<HHI", 999, 0, 6), b"/zeros", struct.pack("<I4sI", 4, b"json", 0))
            zeros = mcap_record(5, struct.pack("<HIQQ", 999, 1, 1, 1), bytes(MB))
        else:
            number = struct.pack("<I", 999)
            fields = packed({"topic": b"/zeros", "type": b"a/B", "md5sum": b"*", "message_definition": b""}, b"")[4:-4]
            schemas = packed({"conn": number, "op": b"\x07", "topic": b"/zeros"}, fields)
            zeros = packed({"conn": number, "op": b"\x02", "time": struct.pack("<II", 1, 1)}, bytes(MB))
        places = [0, *ends[90 :: len(ends) // 100][:100], len(data)]
        return schemas + zeros.join(data[begin:end] for begin, end in pairwise(places))

    return change


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "codec", "piped"),
    [*((*kind, False) for kind in KINDS[:2] + KINDS[4:]), ("mcap", "zstd", True), ("bag", "lz4", True)],
)
def test_a_chunk_of_100_mb_takes_less_than_160_mb(kind, codec, piped, tmp_path):
    source = in_one_chunk(kind, codec, tmp_path / f"in.{kind}", with_zeros(kind), crc=0)
    out = tmp_path / ("out.mcap" if piped else f"out.{kind}")
    words = [sys.executable, "-c", PEAK, *(["-", "-"] if piped else [source, out])]
    with source.open("rb") as stdin, Path("/dev/null" if not piped else out).open("wb") as stdout:
        done = subprocess.run(words, stdin=stdin, stdout=stdout, stderr=subprocess.PIPE, text=True, check=True)
    code, peak = done.stderr.split()[-2:]
    assert int(code) == 0
    assert int(peak) < 160
    found = mcap_messages(out) if piped else SEEN[kind](out)
    zeros = [one.data for one in found if one.topic == "/zeros"]
    assert len(zeros) == 100
    assert set(zeros) == {bytes(MB)}
    assert len(found) == 100 + len(SEEN[kind](OFFICE_MCAP if kind == "mcap" else OFFICE_BAG))

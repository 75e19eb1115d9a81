"""Codecs, checksums and buffers; a chunk too large to be held is read as several, with the same messages and errors."""

import bz2
import importlib
import io
import re
import struct
import subprocess
import sys
import zlib
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

import lz4.frame
import numpy as np
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

from odomcorrupt.bags import checksum, codecs
from odomcorrupt.bags.block import Message
from odomcorrupt.bags.chunk import Chunk
from odomcorrupt.bags.codecs import compress, compress_for_ros1, decompress
from odomcorrupt.bags.open import open_reader, open_writer
from odomcorrupt.bags.pipeline import Workers
from odomcorrupt.bags.source import BufferPool
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


DATA = np.random.default_rng(0).integers(0, 3, 300_000).astype(np.uint8)


FRAMES = {
    "zstd, two frames": ("zstd", lambda d: zstandard.compress(d[:1000]) + zstandard.compress(d[1000:])),
    "zstd without size": ("zstd", zstandard.ZstdCompressor(write_content_size=False).compress),
    "lz4 linked": ("lz4", lz4.frame.compress),
    "lz4 high": ("lz4", lambda d: lz4.frame.compress(d, compression_level=9, content_checksum=True)),
    "bz2 fast": ("bz2", lambda d: bz2.compress(d, 1)),
}


@pytest.mark.parametrize("codec", ["none", "lz4", "zstd", "bz2"])
@pytest.mark.parametrize("pack", [compress, compress_for_ros1])
@pytest.mark.parametrize("size", [0, 1, 300_000])
def test_what_is_compressed_comes_back_writable(codec, pack, size):
    for level in (None, 3) if codec != "none" else (None,):
        out = decompress(codec, memoryview(pack(codec, DATA[:size], level)), size, "chunk", BufferPool())
        np.testing.assert_array_equal(out, DATA[:size])
        assert out.flags.writeable


@pytest.mark.parametrize(("codec", "pack"), FRAMES.values(), ids=FRAMES)
def test_frames_of_other_writers_are_read(codec, pack):
    np.testing.assert_array_equal(
        decompress(codec, memoryview(pack(DATA.tobytes())), DATA.size, "chunk", BufferPool()), DATA
    )


@pytest.mark.parametrize(("codec", "pack"), FRAMES.values(), ids=FRAMES)
@pytest.mark.parametrize("claim", [0, 999, DATA.size - 1, DATA.size + 1, 2**40, 2**62])
def test_a_wrong_size_is_an_error(codec, pack, claim):
    with pytest.raises(BagError, match=f"chunk.*{claim}"):
        decompress(codec, memoryview(pack(DATA.tobytes())), claim, "chunk", BufferPool())


@pytest.mark.parametrize(("codec", "pack"), FRAMES.values(), ids=FRAMES)
def test_a_frame_cut_or_damaged_is_an_error_or_the_same_size(codec, pack):
    whole = pack(DATA.tobytes())
    for cut in (0, 1, 5, len(whole) // 2, len(whole) - 1):
        with pytest.raises(BagError, match="chunk"):
            decompress(codec, memoryview(whole[:cut]), DATA.size, "chunk", BufferPool())
    for place in np.random.default_rng(1).integers(0, len(whole), 30):
        damaged = bytearray(whole)
        damaged[place] ^= 0x55
        with suppress(BagError):
            assert decompress(codec, memoryview(damaged), DATA.size, "chunk", BufferPool()).size == DATA.size


def test_ros1_frames_are_those_the_codec_would_make():
    plain = {"block_linked": False, "store_size": False, "content_checksum": True}
    for level in (0, 3):
        made = bytes(compress_for_ros1("lz4", DATA, level))
        assert made == lz4.frame.compress(DATA.tobytes(), compression_level=level, **plain)
        assert lz4.frame.decompress(made) == DATA.tobytes()


@pytest.mark.parametrize("sized", [False, True])
@pytest.mark.parametrize("place", [4, 5, 6, 300, -6, -1])
def test_an_lz4_frame_with_a_checksum_tells_of_every_damage(place, sized):
    # 6 is the head's own checksum where no size is stated
    frame = bytearray(lz4.frame.compress(DATA.tobytes(), content_checksum=True, store_size=sized))
    frame[place] ^= 0x10
    with pytest.raises(BagError, match="chunk"):
        decompress("lz4", memoryview(frame), DATA.size, "chunk", BufferPool())


@pytest.mark.parametrize(("codec", "level"), [("zstd", 0), ("zstd", 23), ("lz4", 17), ("bz2", 0), ("bz2", 10)])
def test_a_level_that_a_codec_does_not_have_is_refused(codec, level):
    with pytest.raises(BagError, match=f"level {level}"):
        compress(codec, DATA, level)


@pytest.mark.parametrize("sized", [True, False])
@pytest.mark.parametrize("cut", [1, 5, 900])
@pytest.mark.parametrize("kind", ["random", "zeros", "both"])
def test_a_truncated_zstd_frame_is_never_the_less_that_a_chunk_states(kind, cut, sized):
    """The library's reader gives out no more of a truncated frame, once it was asked for less than it holds."""
    noise = np.random.default_rng(1).bytes(100_000)
    data = {"random": noise, "zeros": bytes(100_000), "both": noise + bytes(100_000)}[kind]
    frame = zstandard.ZstdCompressor(write_content_size=sized, write_checksum=True).compress(data)
    for size in (0, 1, 3, len(data) // 2, len(data) - 1):
        with pytest.raises(BagError, match="recover=True"):
            decompress("zstd", memoryview(frame)[:-cut], size, "chunk", BufferPool())


@pytest.mark.parametrize("sized", [True, False])
def test_a_chunk_may_be_several_zstd_frames_and_others_that_are_skipped(sized):
    parts = [np.random.default_rng(n).bytes(n) + bytes(n) for n in (1, 1000, 200_000)]
    compressor = zstandard.ZstdCompressor(write_content_size=sized, write_checksum=True)
    frames = [compressor.compress(part) for part in parts]
    skipped = b"\x5a\x2a\x4d\x18" + (7).to_bytes(4, "little") + b"skipped"
    whole = b"".join([frames[0], skipped, *frames[1:]])
    data = b"".join(parts)
    assert decompress("zstd", memoryview(whole), len(data), "chunk", BufferPool()).tobytes() == data
    with pytest.raises(BagError):
        decompress("zstd", memoryview(whole)[:-1], len(data), "chunk", BufferPool())


@pytest.mark.slow
@pytest.mark.parametrize("frame", ["lz4 linked", "lz4 high"])
def test_a_large_lz4_chunk_is_read_piece_by_piece_with_the_same_checks(frame, monkeypatch):
    monkeypatch.setattr(codecs, "ARENA_BYTES", -1)
    monkeypatch.setattr(codecs, "_PIECE_BYTES", 70_000)
    codec, pack = FRAMES[frame]
    test_frames_of_other_writers_are_read(codec, pack)
    test_a_frame_cut_or_damaged_is_an_error_or_the_same_size(codec, pack)
    for claim in (0, 999, DATA.size - 1, DATA.size + 1, 2**40):
        test_a_wrong_size_is_an_error(codec, pack, claim)
    for place in (4, 300, -6, -1):
        test_an_lz4_frame_with_a_checksum_tells_of_every_damage(place, sized=True)


@pytest.mark.parametrize("sizes", [(0, 0), (5, 0), (0, 7), (1, 1), (1000, 3), (3, 100_001), (70_000, 1 << 17)])
def test_the_combined_crc_is_that_of_the_bytes_together_without_isal_too(sizes, monkeypatch):
    rng = np.random.default_rng(1)
    one, other = (rng.bytes(size) for size in sizes)
    assert checksum.combined(zlib.crc32(one), zlib.crc32(other), len(other)) == zlib.crc32(one + other)
    monkeypatch.setitem(sys.modules, "isal.isal_zlib", None)
    try:
        without = importlib.reload(checksum)
        assert without.crc32 is zlib.crc32
        assert without.combined(zlib.crc32(one), zlib.crc32(other), len(other)) == zlib.crc32(one + other)
    finally:
        monkeypatch.undo()
        importlib.reload(checksum)


BAGS = {
    "mcap": (OFFICE_MCAP, ".mcap", {}),
    "mcap none": (OFFICE_MCAP, ".mcap", {"compression": "none"}),
    "ros1": (OFFICE_BAG, ".bag", {}),
    "ros1 to mcap": (OFFICE_BAG, ".mcap", {"compression": "lz4"}),
}


@pytest.mark.parametrize(("source", "suffix", "options"), BAGS.values(), ids=BAGS)
def test_joined_or_not_the_bytes_are_the_same(source, suffix, options, tmp_path, monkeypatch):
    together = copy(source, tmp_path / f"together{suffix}", **options)
    monkeypatch.setattr(Chunk, "goes_on_with", lambda *_: False)
    alone = copy(source, tmp_path / f"alone{suffix}", **options)
    assert alone.read_bytes() == together.read_bytes()


@pytest.mark.parametrize(("source", "suffix"), [(OFFICE_MCAP, ".mcap"), (OFFICE_BAG, ".bag")])
def test_what_is_added_to_a_joined_block_is_read_by_others(source, suffix, tmp_path):
    seen = mcap_messages if suffix == ".mcap" else ros1_messages
    made = []

    def add(reader, writer, block):
        if not len(block.table):
            return
        odom = next(one for one in reader.channels.values() if one.topic == "/odom")
        made.append(made[0] if made else writer.add_channel("/more", odom.msgtype, odom))
        block.added.append(Message(made[0].id, int(block.table["log_ns"][0]), b"added"))

    out = copy(source, tmp_path / f"out{suffix}", add)
    added = [one for one in seen(out) if one.topic == "/more"]
    assert made
    assert [one.data for one in added] == [b"added"] * len(made)
    assert [one for one in seen(out) if one.topic != "/more"] == seen(source)

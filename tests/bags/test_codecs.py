"""Codecs, checksums, buffers, and neighbouring writes in one."""

import bz2
import importlib
import sys
import zlib
from contextlib import suppress

import lz4.frame
import numpy as np
import pytest
import zstandard
from oracles import OFFICE_BAG, OFFICE_MCAP, copy, mcap_messages, ros1_messages

from odomcorrupt.bags import checksum, codecs
from odomcorrupt.bags.block import Message
from odomcorrupt.bags.chunk import Chunk
from odomcorrupt.bags.codecs import compress, compress_for_ros1, decompress
from odomcorrupt.bags.source import BufferPool
from odomcorrupt.errors import BagError

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

import zlib

import numpy as np
import pytest

from odomcorrupt.bags.block import TABLE, Block
from odomcorrupt.bags.checksum import IncrementalCrc, crc_of_both
from odomcorrupt.bags.messages import Layout
from odomcorrupt.bags.output import Output, Shared


@pytest.mark.parametrize("sizes", [(0, 0), (5, 0), (0, 7), (1, 1), (1000, 3), (3, 100_001), (70_000, 1 << 17)])
def test_crc_of_both_is_that_of_the_bytes_together(sizes):
    rng = np.random.default_rng(1)
    one, other = (rng.bytes(size) for size in sizes)
    assert crc_of_both(zlib.crc32(one), zlib.crc32(other), len(other)) == zlib.crc32(one + other)


@pytest.mark.parametrize("size", [600, 300_000])
@pytest.mark.parametrize("able", [True, False])
def test_what_outputs_share_is_in_all_of_them_and_summed_the_same(size, able, tmp_path, monkeypatch):
    if not able:
        monkeypatch.delattr("os.copy_file_range")
    data = np.random.default_rng(1).bytes(size)
    shared = Shared(data, zlib.crc32(data))
    outputs = [Output(tmp_path / name) for name in "abc"]
    for number, output in enumerate(outputs):
        output.open()
        output.write(b"head" * number)
        output.write_shared(shared)
        output.write(b"tail")
        output.write_shared(shared)
    for number, output in enumerate(outputs):
        output.commit()
        whole = b"head" * number + data + b"tail" + data
        assert (tmp_path / "abc"[number]).read_bytes() == whole
        assert output.crc == zlib.crc32(whole)
        assert output.position == len(whole)
    assert (shared.home is not None) is (size > 100_000 and able) or not able


def test_what_is_written_with_its_sum_is_summed_the_same(tmp_path):
    output = Output(tmp_path / "file")
    output.open()
    output.write(b"head")
    output.write_summed(b"known" * 100, zlib.crc32(b"known" * 100))
    output.commit()
    assert output.crc == zlib.crc32((tmp_path / "file").read_bytes())
    assert output.position == 504


def layout_of(starts, size):
    return Layout(np.arange(len(starts)), np.array(starts, dtype=np.int64), (), size=size)


def chunks_of(data, ends):
    return [data[begin:end].tobytes() for begin, end in zip((0, *ends[:-1]), ends, strict=True)]


@pytest.mark.parametrize("ends", [(), (3000, 3001, 70_000, 200_000)])
def test_chunks_whose_messages_change_sum_up_to_what_is_in_them(ends):
    rng = np.random.default_rng(2)
    data = rng.integers(0, 256, 200_000, dtype=np.uint8)
    read = tuple(map(zlib.crc32, chunks_of(data, ends or (data.size,))))
    block = Block(data, np.empty(0, dtype=TABLE), ends=ends, read_crcs=read)
    odometry, edges = layout_of([0, 2280, 3001, 69_280, 100_000, 199_280], 720), layout_of([5000, 199_100], 80)
    sums = IncrementalCrc(block, [odometry, edges, edges])
    for layout in (odometry, edges):
        for start in layout.starts[1:]:
            data[start + 60 : start + layout.size] = rng.integers(0, 256, layout.size - 60)
    sums.finish()
    assert block.crcs == tuple(map(zlib.crc32, chunks_of(data, ends or (data.size,))))
    assert block.crcs != read


def test_chunks_that_were_not_summed_or_change_all_over_are_left_to_be_summed():
    data = np.zeros(10_000, dtype=np.uint8)
    for read, layout in (((), layout_of([100], 50)), ((zlib.crc32(data),), layout_of(range(0, 9000, 100), 90))):
        block = Block(data, np.empty(0, dtype=TABLE), read_crcs=read)
        sums = IncrementalCrc(block, [layout])
        data[100] += 1
        sums.finish()
        assert block.crcs == ()

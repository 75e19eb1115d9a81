import importlib
import sys
import zlib

import numpy as np
import pytest

from odomcorrupt.bags import checksum
from odomcorrupt.bags.output import Output


@pytest.mark.parametrize("sizes", [(0, 0), (5, 0), (0, 7), (1, 1), (1000, 3), (3, 100_001), (70_000, 1 << 17)])
@pytest.mark.parametrize("combining", [True, False])
def test_crc_of_both_is_that_of_the_bytes_together(sizes, combining, monkeypatch):
    monkeypatch.setattr(checksum, "CAN_COMBINE", combining)
    rng = np.random.default_rng(1)
    one, other = (rng.bytes(size) for size in sizes)
    assert checksum.crc_of_both(zlib.crc32(one), zlib.crc32(other), other) == zlib.crc32(one + other)
    assert checksum.combined(zlib.crc32(one), zlib.crc32(other), len(other)) == zlib.crc32(one + other)


@pytest.mark.parametrize("size", [0, 1, 7, 700, 1 << 16, (1 << 20) + 3])
def test_sums_are_those_of_zlib(size):
    data = np.random.default_rng(2).bytes(size)
    assert checksum.crc32(data) == zlib.crc32(data)
    assert checksum.crc32(data, 12345) == zlib.crc32(data, 12345)


def test_without_isal_zlib_sums(monkeypatch):
    monkeypatch.setitem(sys.modules, "isal.isal_zlib", None)
    try:
        without = importlib.reload(checksum)
        assert without.crc32 is zlib.crc32
        assert without.crc_of_both(zlib.crc32(b"one"), zlib.crc32(b"two"), b"two") == zlib.crc32(b"onetwo")
    finally:
        monkeypatch.undo()
        importlib.reload(checksum)


def test_what_is_written_with_its_sum_is_summed_the_same(tmp_path):
    output = Output(tmp_path / "file")
    output.open()
    output.write(b"head")
    output.write_summed(b"known" * 100, zlib.crc32(b"known" * 100))
    output.commit()
    assert output.crc == zlib.crc32((tmp_path / "file").read_bytes())
    assert output.position == 504


def test_the_sum_of_a_file_counts_what_came_before_a_new_sum(tmp_path):
    output = Output(tmp_path / "file")
    output.open()
    output.write(b"data section")
    assert output.crc_of_all == zlib.crc32(b"data section")
    output.restart_crc()
    output.write(b"summary")
    output.restart_crc()
    output.write_summed(b"end", zlib.crc32(b"end"))
    output.commit()
    assert output.crc == zlib.crc32(b"end")
    assert output.crc_of_all == zlib.crc32((tmp_path / "file").read_bytes())
    output.summing = False
    assert output.crc_of_all is None

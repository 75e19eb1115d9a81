import zlib

import numpy as np
import pytest

from odomcorrupt.bags.checksum import crc_of_both
from odomcorrupt.bags.output import Output


@pytest.mark.parametrize("sizes", [(0, 0), (5, 0), (0, 7), (1, 1), (1000, 3), (3, 100_001), (70_000, 1 << 17)])
def test_crc_of_both_is_that_of_the_bytes_together(sizes):
    rng = np.random.default_rng(1)
    one, other = (rng.bytes(size) for size in sizes)
    assert crc_of_both(zlib.crc32(one), zlib.crc32(other), len(other)) == zlib.crc32(one + other)


def test_what_is_written_with_its_sum_is_summed_the_same(tmp_path):
    output = Output(tmp_path / "file")
    output.open()
    output.write(b"head")
    output.write_summed(b"shared" * 100, zlib.crc32(b"shared" * 100))
    output.write(b"tail")
    output.commit()
    whole = b"head" + b"shared" * 100 + b"tail"
    assert (tmp_path / "file").read_bytes() == whole
    assert output.crc == zlib.crc32(whole)
    assert output.position == len(whole)

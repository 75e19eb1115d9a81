"""Bags of every format through a pipe: all of it comes out, or one line says why not."""

from __future__ import annotations

import subprocess
import sys

import pytest
from smallbags import make_small_bags

from odomcorrupt.bags.open import open_reader

TYPED = ("-", "-", "--odom-topic", "/odom", "--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "7")


@pytest.fixture(scope="module")
def bags(tmp_path_factory):
    return make_small_bags(tmp_path_factory.mktemp("bags"))


def piped(data):
    words = [sys.executable, "-m", "odomcorrupt", *TYPED]
    return subprocess.run(words, input=data, capture_output=True, check=False)


@pytest.mark.parametrize("kind", ["ros1 lz4", "mcap unchunked"])
def test_a_bag_goes_through_a_pipe_whole(kind, bags, tmp_path):
    got = piped(bags[kind].path.read_bytes())
    assert got.returncode == 0, got.stderr
    (tmp_path / "out.mcap").write_bytes(got.stdout)
    with open_reader(tmp_path / "out.mcap") as reader:
        assert sum(len(block.table) for block in reader.blocks()) == bags[kind].count


def test_a_sqlite3_bag_in_a_pipe_is_refused_in_a_line(bags):
    got = piped(bags["sqlite3 file"].path.read_bytes())
    assert (got.returncode, got.stdout) == (1, b"")
    (line,) = got.stderr.decode().splitlines()
    assert line == "odomcorrupt: stdin: a sqlite3 bag cannot come through a pipe; name the file or directory"

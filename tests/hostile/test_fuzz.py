"""Half a minute of damage of all that is read, with seeds that stay; `fuzz.py` and `reader_fuzz.py` run for long."""

import time

import pytest
from fuzz import Fuzz
from reader_fuzz import ReaderFuzz
from smallbags import make_small_bags

KINDS = (
    "mcap zstd", "mcap lz4", "mcap none", "mcap unchunked", "mcap of ros1", "mcap directory", "ros1 bz2", "ros1 lz4",
    "ros1 none", "sqlite3 file", "sqlite3 directory", "model file", "map .yaml", "map .pgm", "CSV", "TUM",
)  # fmt: skip
CASES = 40
SECONDS = 2


@pytest.fixture(scope="module")
def fuzz(tmp_path_factory):
    return Fuzz(tmp_path_factory.mktemp("fuzz"), 0)


def test_every_kind_is_tried(fuzz):
    assert set(fuzz.kinds) == set(KINDS)


@pytest.mark.slow
@pytest.mark.parametrize("kind", KINDS)
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

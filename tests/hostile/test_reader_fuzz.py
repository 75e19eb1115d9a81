"""A few seconds of damage for the readers in memory, with seeds that stay; `reader_fuzz.py` is the long run."""

from __future__ import annotations

import time

import pytest
from reader_fuzz import ReaderFuzz

SECONDS = 1.0
CASES = 200


@pytest.fixture(scope="module")
def fuzz(tmp_path_factory):
    return ReaderFuzz(tmp_path_factory.mktemp("readers"), 0)


def test_damage_is_refused_or_read_alike_in_every_way(fuzz):
    begun = time.monotonic()
    number = 0
    while number < CASES // 10 or (number < CASES and time.monotonic() - begun < SECONDS):
        for kind in fuzz.trials:
            fuzz.case(kind, number)
        number += 1
    assert sum(fuzz.counts.values()) == number * len(fuzz.trials)
    assert {name.rpartition(": ")[2] for name in fuzz.counts} == {"read", "refused", "recovered"}

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
    for kind in fuzz.trials:
        outcomes = {name: count for name, count in fuzz.counts.items() if name.startswith(f"{kind}: ")}
        assert sum(outcomes.values()) >= CASES // 10
        assert len(outcomes) > 1, outcomes

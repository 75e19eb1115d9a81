"""A few kills of the thousand that `crash.py` does."""

import random

import pytest
from crash import rewrites


@pytest.mark.slow
def test_killed_at_any_moment_nothing_half_stands_under_a_name(tmp_path):
    said = rewrites(tmp_path, 8, random.Random(2))  # noqa: S311 - moments, no secrets
    assert said.startswith("8 ")

"""Bags of odometry and truth, written and read again."""

from functools import partial

import pytest
import sourcebags


@pytest.fixture
def read(tmp_path):
    """Write odometry and truth to a bag, return its recordings; see `sourcebags.read`."""
    return partial(sourcebags.read, tmp_path)

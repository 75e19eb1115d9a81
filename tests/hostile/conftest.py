"""Small bags of every format, made once."""

import pytest
from smallbags import make_small_bags


@pytest.fixture(scope="session")
def bags(tmp_path_factory):
    return make_small_bags(tmp_path_factory.mktemp("bags"))

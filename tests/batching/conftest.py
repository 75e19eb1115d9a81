"""The folder that batches are made in."""

import pytest

from recordings import FIXTURES


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Return a directory that is the working one, with links to the bags and a copy of one as in.mcap."""
    monkeypatch.chdir(tmp_path)
    for name in ("office.bag", "office.mcap", "office_ros2", "mystery.mcap"):
        (tmp_path / name).symlink_to(FIXTURES / name)
    (tmp_path / "in.mcap").write_bytes((FIXTURES / "office.mcap").read_bytes())
    return tmp_path

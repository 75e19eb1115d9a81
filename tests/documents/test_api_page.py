"""Every Python example of docs/api.md runs as it stands, in its order, beside the fixtures."""

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "api.md").read_text()
BLOCKS = re.findall(r"^```python\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def plain(text):
    """Return a text without its numbers, whose last digits differ from machine to machine."""
    return re.sub(r"[-+]?\d[\d.e+-]*|\s+", " ", text)


@pytest.mark.slow
def test_every_example_of_the_page_runs(tmp_path, monkeypatch, capsys):
    (tmp_path / "fixtures").symlink_to(ROOT / "fixtures")
    monkeypatch.chdir(tmp_path)
    names = {}
    for block in BLOCKS:
        exec(compile(block, "docs/api.md", "exec"), names)  # noqa: S102 - the page is ours
    said = capsys.readouterr().out
    (printed,) = re.findall(r"^```text\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)
    assert plain(printed) in plain(said)
    for name in ("noisy.mcap", "slipping.mcap", "robot.toml", "errors.png", "corrected.mcap", "secret.mcap"):
        assert (tmp_path / name).stat().st_size > 0
    assert len(repr(names["result"])) < 200
    assert len(repr(names["base"])) < 200

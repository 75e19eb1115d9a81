"""The tutorial does what it says: its commands run in order, and say the lines that the page shows."""

import re
import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

ROOT = Path(__file__).parents[2]
sys.path.append(str(ROOT / "docs"))

import make_tutorial_laser  # noqa: E402 - its folder had to be found first
from make_tutorial import IMAGES, PAGE, play, sessions  # noqa: E402


def words(line: str) -> str:
    """Return a line without its numbers, bars and gaps: the last digits differ from machine to machine."""
    return re.sub(r"(?:[-+]?\d[\d.e+-]*|#+|\s+)+", " ", line).strip()


def test_every_picture_of_the_page_is_there():
    pictures = re.findall(r"\]\((images/[^)]+)\)", PAGE.read_text(encoding="utf8"))
    assert len(pictures) == 4
    assert all((PAGE.parent / picture).stat().st_size > 10_000 for picture in pictures)


def pixels(path: Path) -> np.ndarray:
    """Return a picture's grey values, shape (height, width), within 0 and 1."""
    return imread(path)[..., :3].mean(axis=2)


@pytest.mark.slow
def test_the_tutorial_runs_and_says_what_it_shows(tmp_path):
    for command, shown in sessions():
        answer = play(command, tmp_path)
        said = [words(line) for line in answer.splitlines()]
        for line in shown:
            assert any(words(line) in one for one in said), f"$ {command}\nshould say: {line}"
    # the last word of the page: one effect is left
    assert ", or " not in answer
    for name in ("rejected", "falls", "fan"):
        stored, drawn = (pixels(path) for path in (IMAGES / f"tutorial_{name}.png", tmp_path / f"{name}.png"))
        assert stored.shape == drawn.shape, f"tutorial_{name}.png is stale: run docs/make_tutorial.py"
        # last digits move lines by a pixel; another legend or another curve changes more
        assert np.mean(np.abs(stored - drawn) > 0.15) < 0.01, f"tutorial_{name}.png is stale: run docs/make_tutorial.py"


@pytest.mark.slow
def test_the_laser_tutorial_runs_and_says_what_it_shows(tmp_path):
    page = PAGE.with_name("tutorial-laser.md").read_text(encoding="utf8")
    make_tutorial_laser.write_bags(tmp_path)
    first, *others = re.findall(r"(?m)^(odomcorrupt .*)$", page)
    lines = ["set -e", first, f"{first} -v --force", "cp fixtures/office.mcap .", *others]
    said = play("\n".join(lines), tmp_path)
    assert all((tmp_path / name).exists() for name in ("falls.png", "map.yaml", "corrected.mcap", "noisy.mcap"))
    for line in "".join(re.findall(r"```text\n(.*?)```", page, re.DOTALL)).splitlines():
        assert "more line" in line or words(line) in words(said), line

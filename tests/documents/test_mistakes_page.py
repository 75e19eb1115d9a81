"""docs/how-to/mistakes.md is the table of plain mistakes."""

import sys
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"
sys.path.append(str(DOCS))

from make_mistakes import PAGE, page  # noqa: E402 - its folder had to be found first


def test_the_page_is_the_table():
    """Breaks where a row is changed and `python docs/make_mistakes.py` is not run."""
    assert PAGE.read_text(encoding="utf8") == page()

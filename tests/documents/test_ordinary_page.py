"""docs/ordinary.md is what its script writes from the stored results: no figure in it was typed by hand."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_the_page_of_ordinary_recordings_is_what_its_script_writes(tmp_path):
    page, results = tmp_path / "page.md", ROOT / "benchmarks" / "ordinary" / "results" / "seventh.jsonl"
    words = [sys.executable, str(ROOT / "benchmarks" / "ordinary.py"), "page", str(results), "-o", str(page)]
    done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=100)
    assert done.returncode == 0, done.stderr
    assert page.read_text(encoding="utf8") == (ROOT / "docs" / "ordinary.md").read_text(encoding="utf8")

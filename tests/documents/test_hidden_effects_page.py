"""docs/hidden_effects.md is what its script writes from the stored results: no figure in it was typed by hand."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
RESULTS = ROOT / "benchmarks" / "laboratory" / "results"


def test_the_page_is_what_the_script_writes(tmp_path):
    page = tmp_path / "page.md"
    now, before = (str(RESULTS / f"{run}.jsonl") for run in ("thirteenth", "twelfth"))
    words = ["summary", now, "--before", before, "--page", str(page)]
    done = subprocess.run(
        [sys.executable, str(ROOT / "benchmarks" / "hidden_effects.py"), *words],
        capture_output=True, text=True, check=False, timeout=300,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    written = (ROOT / "docs" / "hidden_effects.md").read_text(encoding="utf8")
    assert page.read_text(encoding="utf8") == written

"""Pages of the laboratories are what their scripts write from stored results: no figure in them is typed by hand."""

import runpy
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
BENCHMARKS = ROOT / "benchmarks"
RUNS = BENCHMARKS / "laboratory" / "results"


@pytest.mark.parametrize(
    ("script", "words", "page"),
    [
        ("hidden_effects.py", ["summary", RUNS / "twentythird.jsonl", "--page"], "hidden_effects.md"),
        ("ordinary.py", ["page", BENCHMARKS / "ordinary" / "results" / "tenth.jsonl", "-o"], "ordinary.md"),
        ("optiodom.py", [BENCHMARKS / "optiodom.json", "--page"], "optiodom.md"),
    ],
)
def test_the_page_is_what_its_script_writes(script, words, page, tmp_path, monkeypatch):
    written = tmp_path / page
    monkeypatch.setattr(sys, "path", [str(BENCHMARKS), *sys.path])
    monkeypatch.setattr(sys, "argv", [script, *map(str, words), str(written)])
    runpy.run_path(str(BENCHMARKS / script), run_name="__main__")
    assert written.read_text(encoding="utf8") == (ROOT / "docs" / page).read_text(encoding="utf8")

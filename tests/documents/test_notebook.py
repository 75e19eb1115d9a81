"""docs/notebook.ipynb runs as it stands, and prints the outputs that are stored in it."""

import json
import re
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "notebook.ipynb"
NOTEBOOK = json.loads(PAGE.read_text(encoding="utf8"))


def without_digits(text: str) -> str:
    """Return a text without its last digits, which differ from machine to machine: numbers keep two figures."""
    return re.sub(r"\d+\.\d+", lambda number: f"{float(number[0]):.2g}", text)


def test_stored_outputs_are_small_complete_and_free_of_the_machine():
    text = PAGE.read_text(encoding="utf8")
    assert len(text) < 120_000
    assert str(ROOT) not in text
    assert "/tmp" not in text  # noqa: S108 - looked for, not written to
    cells = [cell for cell in NOTEBOOK["cells"] if cell["cell_type"] == "code"]
    assert [cell["execution_count"] for cell in cells] == list(range(1, len(cells) + 1))
    assert sum("image/png" in output.get("data", {}) for cell in cells for output in cell["outputs"]) == 2


@pytest.mark.slow
def test_the_notebook_runs_and_prints_what_is_stored():
    pytest.importorskip("ipykernel", reason='no Jupyter kernel; pip install ".[docs]" installs one')
    nbformat = pytest.importorskip("nbformat", reason='nbformat reads notebooks; pip install ".[docs]" installs it')
    pytest.importorskip("nbclient", reason='nbclient executes notebooks; pip install ".[docs]" installs it')
    sys.path.append(str(ROOT / "docs"))
    from make_notebook import execute, texts

    stored = [without_digits(text) for text in texts(nbformat.read(PAGE, as_version=4))]
    assert [without_digits(text) for text in texts(execute())] == stored
    assert any("wheelbase" in text for text in stored)

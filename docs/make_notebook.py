"""Execute docs/notebook.ipynb and store its outputs: `python docs/make_notebook.py`, in a copy of the repository.

Needs `pip install ".[docs]"`. The site shows the stored outputs;
`tests/documents/test_documents.py` compares them with new ones.
"""

from __future__ import annotations

import base64
from io import BytesIO
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from PIL import Image

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "notebook.ipynb"


def execute() -> nbformat.NotebookNode:
    """Return the notebook with outputs, without clock times and names of this machine."""
    notebook = nbformat.read(PAGE, as_version=4)
    NotebookClient(
        notebook, timeout=300, kernel_name="python3", record_timing=False, resources={"metadata": {"path": PAGE.parent}}
    ).execute()
    python = {"name": "python3", "display_name": "Python 3", "language": "python"}
    notebook.metadata = {"kernelspec": python, "language_info": {"name": "python"}}
    for cell in notebook.cells:
        cell.metadata = {}
    return notebook


def texts(notebook: nbformat.NotebookNode) -> list[str]:
    """Return the text of every output in order, pictures as the word `picture`."""
    return [_text(output) for cell in notebook.cells for output in cell.get("outputs", ())]


def _text(output: Any) -> str:
    if output.output_type == "stream":
        return str(output.text)
    if output.output_type == "error":
        return f"{output.ename}: {output.evalue}"
    return "picture" if "image/png" in output.data else str(output.data["text/plain"])


def _palette(png: str) -> str:
    """Return a picture (base64) with 64 colours: a third of the size."""
    small = BytesIO()
    Image.open(BytesIO(base64.b64decode(png))).convert("RGB").quantize(64).save(small, "PNG", optimize=True)
    return base64.b64encode(small.getvalue()).decode()


def main() -> None:
    """Execute it and write it back."""
    notebook = execute()
    for output in (output for cell in notebook.cells for output in cell.get("outputs", ())):
        if "image/png" in output.get("data", {}):
            output.data["image/png"] = _palette(output.data["image/png"])
    nbformat.write(notebook, PAGE)


if __name__ == "__main__":
    main()

"""The sentences of docs/real_robots.md are those of its script; its figures need recordings that are not here."""

import ast
import sys
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[2] / "docs"
sys.path.append(str(DOCS))

from make_real_robots import overview  # noqa: E402 - its folder had to be found first

PAGE = (DOCS / "real_robots.md").read_text(encoding="utf8")


def texts(script: str) -> dict[str, str]:
    """Return the module's constants that are text, by name."""
    return {
        node.targets[0].id: node.value.value
        for node in ast.parse((DOCS / script).read_text(encoding="utf8")).body
        if isinstance(node, ast.Assign) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str)
    }


@pytest.mark.parametrize(
    ("script", "names"),
    [("independent_look.py", {"COMPARISON", "VERDICT"}), ("make_real_robots.py", {"INTRODUCTION", "COMMANDS"})],
)
def test_the_page_has_the_sentences_of_its_script(script, names):
    found = texts(script)
    assert names <= set(found)
    for name in names:
        assert found[name].strip() in PAGE, name


def test_the_first_table_is_that_of_the_sections():
    lines = overview(PAGE)
    assert len(lines) == 2 + 7
    assert "\n".join(lines) in PAGE

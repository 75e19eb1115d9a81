"""What the documents promise about files, lengths and links holds."""

import pydoc
import re
import sys
from pathlib import Path

import pytest

import odomcorrupt

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").rglob("*.md")])


def test_the_readme_is_at_most_a_hundred_lines_long():
    assert len((ROOT / "README.md").read_text(encoding="utf8").splitlines()) <= 100


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_relative_link_leads_to_a_file(page):
    links = re.findall(r"\]\(([^)#\s]+)(?:#[^)]*)?\)", page.read_text(encoding="utf8"))
    missing = [link for link in links if "://" not in link and not (page.parent / link).exists()]
    assert not missing


@pytest.mark.parametrize("page", ["glossary.md", "architecture.md"])
def test_every_module_and_room_that_is_named_exists(page):
    text = (ROOT / "docs" / page).read_text(encoding="utf8")
    named = re.findall(r"`([a-z_]+(?:/[a-z_]+)*(?:/|\.py))`", text)
    assert len(named) > 10
    assert [name for name in named if not (ROOT / "odomcorrupt" / name).exists()] == []


@pytest.mark.parametrize("page", sorted((ROOT / "docs").rglob("*.md")), ids=lambda page: page.name)
def test_no_page_is_a_diary(page):
    months = "January|February|March|April|May|June|July|August|September|October|November|December"
    text = page.read_text(encoding="utf8")
    assert re.findall(rf"\b\d{{1,2}} (?:{months})\b(?! \d{{4}})|[Oo]n the page before", text) == []


def test_every_page_is_in_the_navigation_of_the_site():
    listed = set(re.findall(r"[\w/-]+\.(?:md|ipynb)", (ROOT / "mkdocs.yml").read_text(encoding="utf8")))
    assert {str(page.relative_to(ROOT / "docs")) for page in (ROOT / "docs").rglob("*.md")} <= listed


def test_the_python_reference_has_every_public_name():
    page = (ROOT / "docs" / "api-reference.md").read_text(encoding="utf8")
    listed = re.findall(r"^::: (\S+)$", page, re.MULTILINE)
    public = {f"odomcorrupt.{name}" for name in odomcorrupt.__all__ if name != "__version__"}
    assert public <= set(listed)
    assert len(listed) == len(set(listed))
    # locate imports, and a public name may also be that of a folder that an earlier version left behind
    assert [name for name in listed if name not in public and pydoc.locate(name) is None] == []


def test_every_picture_is_shown_and_has_a_script_that_makes_it():
    texts = {page: page.read_text(encoding="utf8") for page in PAGES}
    shown = {name for text in texts.values() for name in re.findall(r"\]\((?:docs/|\.\./)?images/([\w.-]+)", text)}
    scripts = {path: path.read_text(encoding="utf8") for path in (ROOT / "docs").glob("make_*.py")}
    images = {path.name for path in (ROOT / "docs" / "images").iterdir()}
    assert shown == images
    assert [name for name in sorted(images) if not any(_makes(text, name) for text in scripts.values())] == []


def _makes(script: str, name: str) -> bool:
    """Return whether a script writes a picture of that name, or names of that beginning."""
    folder, _, rest = name.partition("_")
    return f'"{name}"' in script or (bool(rest) and f'f"{folder}_{{' in script)


sys.path.append(str(ROOT / "docs"))

from make_mistakes import PAGE, page  # noqa: E402 - its folder had to be found first


def test_the_page_is_the_table():
    """Breaks where a row is changed and `python docs/make_mistakes.py` is not run."""
    assert PAGE.read_text(encoding="utf8") == page()

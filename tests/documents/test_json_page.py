"""docs/json.md names every key that info, preview and presets print, and no other one."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from odomcorrupt.cli import run

ROOT = Path(__file__).parents[2]
PAGE = (ROOT / "docs" / "json.md").read_text(encoding="utf8")
OFFICE = str(ROOT / "fixtures" / "office.mcap")


def keys_of(values):
    """Return the names of all keys, of lists of objects too."""
    if isinstance(values, dict):
        return set(values).union(*(keys_of(value) for value in values.values()))
    return set().union(*(keys_of(value) for value in values)) if isinstance(values, list) else set()


@pytest.mark.parametrize(("command", "more"), [("info", ()), ("preview", ("--runs", "2"))])
def test_the_page_names_the_keys(command, more, capsys):
    section = PAGE.split(f"## `{command} --json`", 1)[1].split("\n## ", 1)[0]
    table = [line for line in section.splitlines() if line.startswith("| `")]
    first = [re.findall(r"`([^`]+)`", line.split("|")[1]) for line in table]
    topics = re.findall(r"`(\w+)`", next((line for line in table if line.startswith("| `topics[]`")), ""))
    edges = re.findall(r"`(\w+)`", next((line for line in table if line.startswith("| `edges[]`")), ""))
    named = {code.split(".")[-1].removesuffix("[]") for codes in first for code in codes} | {*topics, *edges}
    assert run([command, OFFICE, "--json", *more]) == 0
    values = json.loads(capsys.readouterr().out)
    assert values["schema"] == 2
    assert keys_of(values) - {"schema"} == named

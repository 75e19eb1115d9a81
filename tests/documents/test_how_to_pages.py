"""Every odomcorrupt command on a how-to page is understood: its options exist and their values make sense."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import click
import pytest

from odomcorrupt.cli import cli
from odomcorrupt.scoring.gate import parse_rule

DOCS = Path(__file__).parents[2] / "docs"
PAGES = [*sorted((DOCS / "how-to").glob("*.md")), DOCS / "score.md", DOCS / "batch.md"]


def commands(page):
    text = page.read_text(encoding="utf8")
    blocks = re.findall(r"```(?:sh|yaml)\n(.*?)```", text, re.DOTALL) + re.findall(
        r"(?m)^    odomcorrupt (?:.* \\\n)*.*$", text
    )
    for block in blocks:
        folded = re.sub(r" \\\n\s+", " ", block)
        folded = re.sub(r">-?\n\s+", "", folded)  # a folded text of YAML
        folded = re.sub(r"\n\s+(--)", r" \1", folded)
        for line in folded.splitlines():
            match = re.match(r"\s*(?:- (?:run: )?)?(odomcorrupt .*)", line)
            if match:
                yield match[1].replace("$((SLURM_ARRAY_TASK_ID + 1))", "1")


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.stem)
def test_every_command_is_understood(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for folder in ("runs", "estimates"):
        (tmp_path / folder).mkdir()
    for file in ("drive.mcap", "in.mcap", "in.bag", "robot.toml", "last.json", *(f"{name}.toml" for name in "abc")):
        (tmp_path / file).touch()
    found = list(commands(page))
    for line in found:
        name, *words = shlex.split(line)[1:]
        command = cli.get_command(click.Context(cli), name)
        if command is None:
            name, words = "corrupt", [name, *words]
            command = cli.get_command(click.Context(cli), name)
        assert command is not None, line
        context = command.make_context(name, words, parent=click.Context(cli, **cli.context_settings))
        for rule in context.params.get("rules") or ():
            parse_rule(rule)
    assert found or page.stem == "pytest"

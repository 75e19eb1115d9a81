"""docs/json.md names every key that the commands print, and of info and preview no other one."""

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


def printed(words, capsys):
    """Return the object that a command prints, on stdout or stderr."""
    assert run([*words, "--json"]) == 0
    return json.loads("".join(capsys.readouterr()).split("\nwrote ", 1)[0])


def unnamed(values, heading):
    """Return the keys that a section of the page does not name; those below them that are names of topics stay out."""
    section = PAGE.split(f"## {heading}", 1)[1].split("\n## ", 1)[0]
    words = set(re.findall(r"`([^`]+)`", section))
    named = {part for word in words for part in re.split(r"\W+", word)}
    return {key for key in keys_of(values) if key not in named and key != "schema"}


COEFFICIENTS = {"rot_rot", "rot_trans", "trans_trans", "trans_rot", "across_trans"}


def test_the_page_names_the_keys_of_a_comparison(tmp_path, capsys):
    model = tmp_path / "typical.toml"
    run(["presets", "typical"])
    model.write_text(capsys.readouterr().out)
    values = printed(["compare", str(ROOT / "fixtures" / "mystery_other.mcap"), str(model)], capsys)
    assert unnamed(values, "`compare --json`") == set()


def test_the_page_names_the_keys_of_a_fit(tmp_path, capsys):
    words = ["fit", str(ROOT / "fixtures" / "mystery_other.mcap"), "-o", str(tmp_path / "robot.toml")]
    values = printed(words, capsys)
    assert unnamed(values, "`fit --json`") <= COEFFICIENTS


def test_the_page_names_the_keys_of_commands_that_write(tmp_path, capsys):
    values = printed([OFFICE, str(tmp_path / "noisy.mcap"), "--seed", "1"], capsys)
    heading = "Corruption, `correct`, `batch`"
    assert unnamed(values, heading) <= COEFFICIENTS | {"/odom", "odom -> base_link"}
    words = ["batch", OFFICE, str(tmp_path / "runs"), "--runs", "2", "--seed", "1", "--output", "trajectories"]
    assert unnamed(printed(words, capsys), heading) == set()
    words = ["simulate", str(tmp_path / "run.mcap"), "--seed", "1", "--duration", "30"]
    assert unnamed(printed(words, capsys), "Other commands") == set()

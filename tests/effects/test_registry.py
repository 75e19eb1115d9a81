"""Effects of other packages, words among parameters, and the command that explains effects."""

from __future__ import annotations

import dataclasses
import importlib.metadata
import json
from importlib.metadata import EntryPoint

import pytest
import test_contract  # noqa: F401 - whole before it is an entry point
from click.testing import CliRunner

from odomcorrupt.cli import cli, run
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.errors import EffectError


@pytest.fixture
def plugged(monkeypatch):
    def plug(*points):
        monkeypatch.setattr(importlib.metadata, "entry_points", lambda group: [EntryPoint(*p, group) for p in points])
        registry.cache_clear()
        return registry()

    yield plug
    registry.cache_clear()


def test_another_packages_effect_is_found(plugged):
    assert "good" in plugged(("good", "test_contract:Good"))


@pytest.mark.parametrize(
    ("value", "complaint"),
    [
        ("test_contract:Missing", "cannot be loaded"),
        ("json:dumps", "not an effect class"),
        ("odomcorrupt.effects.gains:Wheelbase", "taken"),
    ],
)
def test_a_broken_one_is_reported_and_stops_nothing(plugged, value, complaint):
    before = set(registry())
    with pytest.warns(UserWarning, match=complaint):
        found = plugged(("bad", value))
    assert set(found) == before


@pytest.mark.parametrize(
    ("name", "values", "complaint"),
    [
        ("wheel_scal", {}, r"did you mean wheel_scale\?"),
        ("gauss_markov", {"chanel": "yaw"}, r"did you mean channel\?"),
        ("gauss_markov", {"channel": "up"}, "write along or yaw or wheels"),
        ("gauss_markov", {"sigma": "much"}, "must be a number"),
        ("backlash", {"travel": -0.001}, r"must lie in \[0, 0.05\] m"),
    ],
)
def test_what_is_wrong_with_an_effect_is_said(name, values, complaint):
    with pytest.raises(EffectError, match=complaint):
        effect_from_values(name, values)


def page(*args):
    result = CliRunner().invoke(cli, ["effects", *(args if "--json" in args else ("-v", *args))])
    assert result.exit_code == 0, result.output
    return result.output


def test_the_list_names_every_effect_with_kind_and_summary():
    text = page()
    for name, kind in registry().items():
        line = next(line for line in text.splitlines() if line.startswith(f"{name} "))
        assert kind.kind in line
        assert kind.summary in line


@pytest.mark.parametrize("name", registry())
def test_a_page_tells_everything(name):
    text, kind = page(name), registry()[name]
    for part in kind.about:
        assert (", ".join(part) if isinstance(part, tuple) else part) in text
    facts = json.loads(page(name, "--json"))
    assert facts["confused_with"] == list(kind.about.confused_with)
    assert {p["name"] for p in facts["parameters"]} | set(facts["words"]) == {f.name for f in dataclasses.fields(kind)}


def test_the_example_of_a_page_can_be_typed():
    from odomcorrupt.model.effect_notation import parse_effect

    for name in registry():
        example = page(name).splitlines()[-1].split()[-1]
        assert parse_effect(example).effect.name == name
        assert parse_effect(example).effect.acts


def test_a_word_can_be_typed():
    from odomcorrupt.model.effect_notation import parse_effect

    assert parse_effect("gauss_markov:sigma=0.1,channel=yaw").effect.channel == "yaw"


def test_json_lists_all():
    assert [e["name"] for e in json.loads(page("--json"))["effects"]] == list(registry())


def test_an_unknown_name_fails_with_the_nearest_one(capsys):
    assert run(["effects", "wheel_bas"]) == 1
    assert "did you mean wheelbase?" in capsys.readouterr().err

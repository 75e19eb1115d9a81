"""The registry of effects, and effects named on the command line."""

import dataclasses
import importlib.metadata
import json
import sys
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest
import test_contract  # noqa: F401 - whole before it is an entry point
from click.testing import CliRunner

from odomcorrupt.bags.open import open_reader
from odomcorrupt.cli import cli, run
from odomcorrupt.effects import effect_from_values, registry
from odomcorrupt.errors import EffectError
from odomcorrupt.inspection import scan_bag


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
    from odomcorrupt.model.model_file import parse_effect

    for name in registry():
        example = page(name).splitlines()[-1].split()[-1]
        assert parse_effect(example).effect.name == name
        assert parse_effect(example).effect.acts


def test_json_lists_all():
    assert [e["name"] for e in json.loads(page("--json"))["effects"]] == list(registry())


OFFICE = str(Path(__file__).parent.parent.parent / "fixtures" / "office.mcap")
WOBBLE = """
from dataclasses import dataclass
from typing import ClassVar

from odomcorrupt.effects.effect import Effect, Kind, TwistError, parameter, stacked


@dataclass(frozen=True, slots=True)
class Wobble(Effect):
    name: ClassVar[str] = "wobble"
    kind: ClassVar[Kind] = "effect"
    summary: ClassVar[str] = "the robot sways"

    k: float = parameter("", "of the speed", low=-0.1, high=0.1, typical=0.01)

    def twist_error(self, motion, state):
        return TwistError(stacked(0.0, self.k * motion.v, 0.0, motion.v), state)


class Plain:
    pass
"""
NONE = "rot_rot = 0\nrot_trans = 0\ntrans_trans = 0\ntrans_rot = 0"
WORDS = 'expression = "across += k * v"\nk = 0.05\n'


def drive_of(path):
    """Return the odometry's poses (n, 3)."""
    with open_reader(path) as reader:
        return scan_bag(reader).odometry[0].xyt


@pytest.fixture
def folder(tmp_path, monkeypatch):
    (tmp_path / "sway_in_folder.py").write_text(WOBBLE)
    (tmp_path / "sway_broken.py").write_text("1 / 0\n")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    return tmp_path


def test_a_class_of_this_folder_acts_as_the_same_words_in_a_model_file_do(folder, capsys):
    assert run([OFFICE, "own.mcap", "-v", "--seed", "1", "--effect", "sway_in_folder.Wobble:k=0.05"]) == 0
    assert "effects wobble (k 0.05)" in capsys.readouterr().err
    Path("robot.toml").write_text(f'schema = 1\n[noise]\n{NONE}\n[[effect]]\nname = "words"\n{WORDS}')
    assert run([OFFICE, "words.mcap", "-v", "--seed", "1", "--model", "robot.toml"]) == 0
    own, words, clean = (drive_of(Path(name)) for name in ("own.mcap", "words.mcap", OFFICE))
    assert np.abs(own - words).max() < 1e-9
    assert np.abs(own - clean).max() > 0.01


@pytest.mark.parametrize(
    ("effect", "sentence"),
    [
        ("sway_in_folder.Wobble:k=7", "effect wobble, k: 7; it must lie in"),
        ("sway_in_folder.Wobble:q=7", "effect wobble has no parameter 'q'"),
        ("sway_in_folder.Plain", "sway_in_folder.Plain: is not an effect class"),
        ("sway_in_folder.Missing", "sway_in_folder.Missing: is not an effect class"),
        ("sway_nowhere.Wobble", "sway_nowhere cannot be imported (ModuleNotFoundError"),
        ("sway_broken.Wobble", "sway_broken cannot be imported (ZeroDivisionError: division by zero)"),
        (".Wobble", "cannot be imported"),
    ],
)
def test_what_is_no_effect_is_one_line_of_wrong_usage(folder, capsys, effect, sentence):
    assert run([OFFICE, "out.mcap", "--effect", effect]) == 2
    said = capsys.readouterr().err
    assert sentence in said
    assert said.count("\n") == 1


def test_a_model_file_names_no_code(folder, capsys):
    Path("robot.toml").write_text(f'schema=1\n[noise]\n{NONE}\n[[effect]]\nname = "sway_in_folder.Wobble"\nk = 0.01\n')
    assert run([OFFICE, "out.mcap", "--model", "robot.toml"]) == 1
    assert "no effect is called 'sway_in_folder.Wobble'" in capsys.readouterr().err


@pytest.mark.usefixtures("folder")
def test_workers_of_a_batch_find_the_class_too(capsys):
    words = ["batch", OFFICE, "runs", "--runs", "2", "--jobs", "2", "--seed", "1", "--output", "trajectories"]
    assert run([*words, "--effect", "sway_in_folder.Wobble:k=0.05"]) == 0, capsys.readouterr().err

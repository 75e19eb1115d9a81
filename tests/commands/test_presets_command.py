"""Presets: listed with law, numbers and source; printed as model files."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import pytest

from odomcorrupt.cli import run
from odomcorrupt.model.model_file import parse_model
from odomcorrupt.model.presets import PRESETS

OFFICE = str(Path(__file__).parents[2] / "fixtures" / "office.mcap")


def test_the_list_has_law_numbers_and_source_of_each(capsys):
    assert run(["presets", "-v"]) == 0
    text = capsys.readouterr().out
    for preset in PRESETS.values():
        entry = text.split(f"{preset.name}\n", 1)[1].split("\n\n", 1)[0]
        assert f"law {preset.noise.law_name}:" in entry
        assert f"rot_trans {preset.noise.coefficients.rot_trans:.4g}" in entry
        assert preset.source in entry
    assert run(["presets", "--json"]) == 0
    assert [p["name"] for p in json.loads(capsys.readouterr().out)["presets"]] == list(PRESETS)


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_printed_as_a_model_file_of_the_same_noise(name, capsys, tmp_path):
    assert run(["presets", name]) == 0
    file = tmp_path / "robot.toml"
    file.write_text(capsys.readouterr().out)
    read, preset = parse_model(file.read_text()), PRESETS[name]
    assert (read.noise.law_name, read.effects) == (preset.noise.law_name, ())
    assert asdict(read.noise.coefficients) == pytest.approx(asdict(preset.noise.coefficients), rel=1e-8)
    assert read.source["from"] == preset.source
    assert run([OFFICE, str(tmp_path / "out.mcap"), "-v", "--seed", "1", "--model", str(file)]) == 0
    assert f"(of {file})" in capsys.readouterr().err


def test_a_preset_that_is_none_is_wrong_usage_of_this_command(capsys):
    assert run(["presets", "ideal"]) == 2
    said = capsys.readouterr().err
    assert "no preset is called 'ideal'; there are typical" in said
    assert "(see odomcorrupt presets --help)" in said


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["nosuch"], "nosuch: no such file, and no such command; name a command, or INPUT and OUTPUT"),
        ([OFFICE], "Missing argument 'OUTPUT'"),
        (["presest"], "did you mean presets?"),
    ],
)
def test_one_word_alone_is_reported_what_it_is_not(words, sentence, capsys):
    assert run(words) == 2
    assert sentence in capsys.readouterr().err

"""Options that every command has, and defaults from a file."""

from __future__ import annotations

import io
import json
from pathlib import Path

import click
import pytest

from odomcorrupt.cli import cli, run
from odomcorrupt.commands._standard import _colours

ROOT = Path(__file__).parent.parent.parent
OFFICE = str(ROOT / "fixtures" / "office.mcap")
COMMANDS = cli.list_commands(click.Context(cli))


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_the_standard_options(name, capsys):
    command = cli.get_command(click.Context(cli), name)
    words = {word for option in command.params for word in option.opts}
    assert {"-v", "--verbose", "-q", "--quiet", "--json", "--config"} <= words
    assert ("--force" in words) == ("--overwrite" in words)
    assert run([name, "-h"]) == 0
    assert "Usage: odomcorrupt" in capsys.readouterr().out


@pytest.mark.parametrize("name", ["corrupt", "correct", "assemble", "batch", "simulate", "integrate"])
def test_the_output_may_be_named_by_an_option(name):
    words = {word for option in cli.get_command(click.Context(cli), name).params for word in option.opts}
    assert "-o" in words


def test_the_output_is_named_once(tmp_path, capsys):
    assert run([OFFICE, "-o", str(tmp_path / "a.mcap"), "--seed", "1"]) == 0
    assert (tmp_path / "a.mcap").exists()
    assert run([OFFICE, str(tmp_path / "b.mcap"), "-o", str(tmp_path / "c.mcap")]) == 2
    assert "both name the output" in capsys.readouterr().err
    assert run([OFFICE, "--seed", "1"]) == 2
    assert "Missing argument 'OUTPUT'" in capsys.readouterr().err


def test_a_verdict_everything_nothing_or_values(tmp_path, capsys):
    def said(*more):
        assert run([OFFICE, str(tmp_path / "a.mcap"), "--force", "--seed", "1", *more]) == 0
        return capsys.readouterr().err

    brief = said()
    assert brief.startswith("MOVED ")
    assert len(brief.splitlines()) <= 8
    assert "computed from the poses of /odom" in said("-v")
    assert said("-q") == ""
    assert json.loads(said("--json"))["seed"] == 1
    assert run([OFFICE, str(tmp_path / "a.mcap"), "-q", "-v"]) == 2


def test_colours_are_for_terminals_whose_user_wants_them(monkeypatch):
    class Terminal(io.StringIO):
        def isatty(self):
            return True

    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert _colours(Terminal())
    assert not _colours(io.StringIO())
    monkeypatch.setenv("NO_COLOR", "1")
    assert not _colours(Terminal())


def test_defaults_come_from_a_file_and_what_is_typed_wins(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("odomcorrupt.toml").write_text('seed = 5\n[corrupt]\nalpha = [0.1, 0.1, 0.1, 0.1]\n[learn]\nscan = "/scan"\n')
    assert run([OFFICE, "a.mcap"]) == 0
    said = capsys.readouterr().err
    assert "defaults from odomcorrupt.toml: alpha, seed" in said
    assert "diffusion, alpha 0.1 0.1 0.1 0.1" in said
    assert "seed      5" in said
    assert run([OFFICE, "b.mcap", "--preset", "article", "--seed", "6"]) == 0
    said = capsys.readouterr().err
    assert "defaults from odomcorrupt.toml: alpha\n" in said
    assert "preset article" in said
    assert "seed      6" in said
    Path("other.toml").write_text("seed = 9\n")
    assert run([OFFICE, "c.mcap", "--config", "other.toml"]) == 0
    assert "seed      9" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("sed = 1\n", "sed: no command has this option"),
        ("[corrupt]\nsed = 1\n", "[corrupt] sed: is not an option"),
        ("[corupt]\nseed = 1\n", "[corupt] is not a command"),
        ("seed = \n", "not valid TOML"),
        ('seed = "x"\n', "'x' is not a valid integer"),
    ],
)
def test_a_wrong_file_of_defaults_is_an_error(text, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("odomcorrupt.toml").write_text(text)
    assert run([OFFICE, "a.mcap"]) == 2
    line = capsys.readouterr().err
    assert said in line
    assert line.count("\n") == 1
    assert not Path("a.mcap").exists()


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (
            ["a.mcap", "--odom-frame", "odomx"],
            "--odom-frame odomx: no odometry message and no transform has this frame",
        ),
        (["a.bga"], "a.bga: .bga is not a bag format (did you mean .bag?)"),
        (["a.mcap", "--effect", "wheel_scale=0.01"], "write wheel_scale:e=0.01"),
        (["a.mcap", "--effect", "unequal_wheels:curvature=1%"], "is a share, but the parameter has the unit rad/m"),
        (["a.mcap", "--alpha", "0.05,0.02,0.05,0.01"], "put spaces between the numbers: --alpha 0.05 0.02 0.05 0.01"),
    ],
)
def test_silent_mistakes_are_errors(words, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert run([OFFICE, *words]) in (1, 2)
    line = capsys.readouterr().err
    assert said in line
    assert line.count("\n") == 1
    assert list(tmp_path.iterdir()) == []


def test_an_effect_without_numbers_has_its_typical_size_and_says_so(tmp_path, capsys):
    assert run([OFFICE, str(tmp_path / "a.mcap"), "--effect", "unequal_wheels", "--seed", "1"]) == 0
    assert "unequal_wheels at its typical size, curvature 0.005 rad/m" in " ".join(capsys.readouterr().err.split())


def test_a_step_may_be_a_distance_alone(tmp_path, capsys):
    numbers = ["--law", "linear", "--alpha", "0.05", "0.1", "0.05", "0.01", "--seed", "1"]
    assert run([OFFICE, str(tmp_path / "a.mcap"), *numbers, "--step", "0.25m"]) == 0
    assert "once per 0.25m,0.2rad" in capsys.readouterr().err
    assert run([OFFICE, str(tmp_path / "b.mcap"), *numbers, "--step", "0.1rad"]) == 0
    assert "once per 0.25m,0.1rad" in capsys.readouterr().err

"""Options that every command has, and defaults from a file."""

import io
import json
import re
from pathlib import Path

import click
import pytest

from odomcorrupt.cli import cli, run
from odomcorrupt.commands._options import PICTURE
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
    assert "-o" in words or name not in ("corrupt", "correct", "assemble", "batch", "simulate", "integrate")
    assert run([name, "-h"]) == 0
    assert "Usage: odomcorrupt" in capsys.readouterr().out


def test_the_output_is_named_once(tmp_path, capsys):
    assert run([OFFICE, "-o", str(tmp_path / "a.mcap"), "--seed", "1"]) == 0
    assert (tmp_path / "a.mcap").exists()
    assert run([OFFICE, str(tmp_path / "b.mcap"), "-o", str(tmp_path / "c.mcap")]) == 2
    assert "both name the output" in capsys.readouterr().err


def test_a_verdict_everything_nothing_or_values(tmp_path, capsys):
    def said(*more):
        assert run([OFFICE, str(tmp_path / "a.mcap"), "--force", "--seed", "1", *more]) == 0
        return capsys.readouterr().err

    brief = said()
    assert brief.startswith("MOVED ")
    assert len(brief.splitlines()) <= 8
    assert "computed from the poses of /odom" in said("-v")
    assert said("-q") == ""
    assert re.search(r"\AMOVED  .*\nnext  odomcorrupt info .*\Z", said("-v"), re.DOTALL)
    assert said("--json") == ""
    assert run([OFFICE, str(tmp_path / "a.mcap"), "-q", "-v"]) == 2


def test_json_goes_to_stdout_unless_a_bag_does(tmp_path, capfdbinary):
    assert run([OFFICE, str(tmp_path / "a.mcap"), "--seed", "1", "--json"]) == 0
    said = capfdbinary.readouterr()
    assert json.loads(said.out)["seed"] == 1
    assert said.err == b""
    assert run([OFFICE, "-", "--seed", "1", "--json"]) == 0
    said = capfdbinary.readouterr()
    assert said.out == (tmp_path / "a.mcap").read_bytes()
    assert json.loads(said.err)["seed"] == 1
    batch = ["batch", OFFICE, str(tmp_path / "runs"), "--runs", "1", "--output", "overlay", "--seed", "1", "--json"]
    for words in (batch, ["assemble", str(tmp_path / "runs" / "run_000000.mcap"), str(tmp_path / "b.mcap"), "--json"]):
        assert run(words) == 0
        assert json.loads(capfdbinary.readouterr().out)["schema"] == 2


@pytest.mark.parametrize("words", [["preview", OFFICE, "--runs", "2"], ["simulate", "OUT", "--duration", "15"]])
def test_a_seed_is_drawn_and_printed_where_none_is_given(words, tmp_path, capsys):
    seen = set()
    for name in ("a", "b"):
        given = [word.replace("OUT", str(tmp_path / f"{name}.mcap")) for word in words]
        assert run([*given, "--json"]) == 0
        seen.add(json.loads(capsys.readouterr().out)["seed"])
    assert len(seen) == 2


@pytest.mark.parametrize(("value", "hinted"), [("2", True), ("2%", False), ("-0.6", True), ("0.3", False)])
def test_a_fraction_that_should_be_a_percentage_gets_a_hint(value, hinted, tmp_path, capsys):
    words = [OFFICE, str(tmp_path / "a.mcap"), "--seed", "1", "--effect", f"wheelbase:e={value}"]
    assert run(words) == 0
    assert ("robots have about 1.5 %" in capsys.readouterr().err) is hinted
    assert run([*words, "--overwrite", "-q"]) == 0
    assert capsys.readouterr().err == ""


def test_an_option_of_one_meaning_has_one_name_in_all_commands():
    options = {
        name: {word: option for option in cli.get_command(click.Context(cli), name).params for word in option.opts}
        for name in cli.list_commands(click.Context(cli))
    }
    for words in options.values():
        assert ("--add" in words) <= ("--effect" in words)
        pictures = {word for word, option in words.items() if option.type is PICTURE}
        assert not pictures or "--plot" in pictures
    drawing = ("preview", "spread", "score", "density", "integrate", "learn", "map", "sample", "compare")
    assert all("--plot" in options[name] for name in drawing)


def test_an_interrupted_batch_says_what_is_kept(tmp_path, capsys, monkeypatch):
    words = ["batch", OFFICE, str(tmp_path / "runs"), "--output", "trajectories", "--seed", "1"]
    assert run([*words, "--runs", "2"]) == 0
    capsys.readouterr()

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("odomcorrupt.api.batch.run_batch", interrupted)
    assert run([*words, "--runs", "9"]) == 130
    said = capsys.readouterr().err
    assert f"interrupted: 2 runs are complete in {tmp_path / 'runs'}; the same command makes the others" in said


def test_colours_are_for_terminals_whose_user_wants_them(monkeypatch):
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.delenv("NO_COLOR", raising=False)
    assert _colours(terminal)
    assert not _colours(io.StringIO())
    monkeypatch.setenv("NO_COLOR", "1")
    assert not _colours(terminal)


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
    [("sed = 1\n", "sed: no command has this option"),
    ("[corrupt]\nsed = 1\n", "[corrupt] sed: is not an option"),
    ("[corupt]\nseed = 1\n", "[corupt] is not a command"),
    ("seed = \n", "not valid TOML"),
    ('seed = "x"\n', "'x' is not a valid integer")],
)  # fmt: skip
def test_a_wrong_file_of_defaults_is_an_error(text, said, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("odomcorrupt.toml").write_text(text)
    assert run([OFFICE, "a.mcap"]) == 2
    line = capsys.readouterr().err
    assert said in line
    assert line.count("\n") == 1
    assert not Path("a.mcap").exists()


def test_an_effect_without_numbers_has_its_typical_size_and_says_so(tmp_path, capsys):
    assert run([OFFICE, str(tmp_path / "a.mcap"), "--effect", "unequal_wheels", "--seed", "1"]) == 0
    assert "unequal_wheels at its typical size, curvature 0.005 rad/m" in " ".join(capsys.readouterr().err.split())


def test_a_step_may_be_a_distance_alone(tmp_path, capsys):
    numbers = ["--law", "linear", "--alpha", "0.05", "0.1", "0.05", "0.01", "--seed", "1"]
    assert run([OFFICE, str(tmp_path / "a.mcap"), *numbers, "--step", "0.25m"]) == 0
    assert "once per 0.25m,0.2rad" in capsys.readouterr().err
    assert run([OFFICE, str(tmp_path / "b.mcap"), *numbers, "--step", "0.1rad"]) == 0
    assert "once per 0.25m,0.1rad" in capsys.readouterr().err

"""What commands print by default: eight lines of eighty columns, or nine, the verdict first, a command last."""

import json
import shlex
import shutil
from pathlib import Path

import pytest
from ruamel.yaml import YAML

from odomcorrupt.cli import run
from odomcorrupt.effects import registry

FIXTURES = Path(__file__).parents[2] / "fixtures"
OFFICE = str(FIXTURES / "office.mcap")
NOISE = ["--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "1"]
MAP = ["map", OFFICE, "--resolution", "0.2", *NOISE]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Return a directory with the paths of a few runs."""
    path = tmp_path_factory.mktemp("batch") / "runs"
    assert run(["batch", OFFICE, str(path), "--runs", "4", "--output", "trajectories", "-q", *NOISE]) == 0
    return str(path)


def lines_of(capsys, words):
    assert run(words) == 0
    return capsys.readouterr().out.splitlines()


def require_brief(lines, label, most=8):
    assert lines[0].startswith(label)
    assert len(lines) <= most + 1
    assert not any("1 more line" in line for line in lines)
    assert max(map(len, lines)) <= 80
    assert any(line.startswith("next") for line in lines)
    assert lines[-1].startswith(("next", " "))


@pytest.mark.parametrize("name", registry())
def test_an_effect_is_explained_in_eight_lines(name, capsys):
    require_brief(lines_of(capsys, ["effects", name]), name)


@pytest.mark.parametrize(
    ("words", "label"),
    [(["presets"], "PRESETS"),
    (["effects"], "SYSTEMATIC"),
    (["integrate", OFFICE], "INTEGRATED"),
    (["integrate", OFFICE, "--twist-noise", "0.2", "0.04", "--runs", "3", "--seed", "1"], "INTEGRATED"),
    (MAP, "THICKER"),
    (["preview", OFFICE, "--runs", "2", "--seed", "1"], "DRIFT")],
)  # fmt: skip
def test_a_result_has_eight_lines_all_of_it_nothing_or_values(words, label, capsys):
    # a list of names leaves none out
    require_brief(lines_of(capsys, words), label, most=13 if words == ["effects"] else 8)
    full = lines_of(capsys, [*words, "-v"])
    # more, and not something else: the verdict and the next command, which lists of names have not
    assert len(words) == 1 or (
        any(row.startswith(label) for row in full) and any(row.startswith("next") for row in full)
    )
    assert lines_of(capsys, [*words, "-q"]) == []
    assert json.loads("\n".join(lines_of(capsys, [*words, "--json"])))["schema"] == 2


def test_a_spread_begins_with_whether_it_is_the_predicted_one(runs, capsys):
    lines = lines_of(capsys, ["spread", runs])
    assert lines[0].startswith(("AS PREDICTED", "WIDER", "NARROWER"))
    require_brief(lines, "")
    assert "4 runs" in lines[0]
    assert any(row.split()[:1] == ["after"] for row in lines_of(capsys, ["spread", runs, "-v"]))


def test_the_table_of_a_map_fits_a_hundred_columns(capsys):
    table = [line for line in lines_of(capsys, [*MAP, "-v"]) if " m  " in line and line[:2] == "  "]
    assert len(table) >= 3
    assert max(map(len, table)) <= 100


@pytest.mark.parametrize("target", ["nav2", "robot_localization", "ros2_control"])
def test_parameters_stand_without_their_derivation_unless_it_is_asked_for(target, tmp_path, capsys):
    model = tmp_path / "robot.toml"
    model.write_text("\n".join(lines_of(capsys, ["presets", "article"])) + "\n[[effect]]\nname='side_slip'\nk=0.1\n")
    brief, full = (lines_of(capsys, ["export", str(model), "--to", target, *more]) for more in ([], ["-v"]))
    assert max(map(len, brief + full)) <= 80
    assert len(brief) <= 8 < len(full)
    assert YAML().load("\n".join(brief)) == YAML().load("\n".join(full))
    assert brief[0] == "# not expressed: side_slip (-v says why)"


@pytest.mark.parametrize(
    ("typed", "last"),
    [("info in.mcap", "noisy.mcap"),
    ("batch in.mcap runs --runs 2 --preset typical --output trajectories --seed 1", "preview run_000000.mcap"),
    ("batch in.mcap runs --runs 2 --seed 1", "info runs/run_000000.mcap"),
    ("sample -n 50 --seed 2", "density -n 50 --seed 2 --plot density.png"),
    ("integrate in.mcap --twist-noise 0.2 0.04 --seed 1 --runs 3", "--plot errors.png"),
    ("learn mystery.mcap -o robot.toml", "export robot.toml --to ros2_control"),
    ("diagnose mystery.mcap", "sim.bag noisy.bag --model robot.toml"),
    ("batch in.mcap runs --runs 2 --seed 1; score runs --estimate /odom --align origin", "--report page.html"),
    ("map in.mcap --resolution 0.2 --seed 1", "-o map.png"),
    ("effects wheelbase; convert-alpha 0.2 0.1 0.2 0.2 --from quadratic --step 0.25m --to diffusion", "e=0.015")],
)  # fmt: skip
def test_each_suggested_command_runs_and_those_that_it_suggests(typed, last, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    for name in ("in.mcap", "in.bag", "sim.bag"):
        shutil.copy(FIXTURES / f"office{Path(name).suffix}", name)
    shutil.copy(FIXTURES / "mystery.mcap", ".")
    todo, done = typed.split("; "), {}
    for line in todo:
        words = shlex.split(line)
        kind = (words[0], *(option in words for option in ("--plot", "-o", "--report")))
        if kind not in done:
            done[kind] = line
            assert run(words) == 0, done
            _, _, said = f"{''.join(capsys.readouterr())}\nnext ".replace("\\\n", "").partition("\nnext ")
            following = [" ".join(row.split()) for row in said.splitlines() if "odomcorrupt " in row]
            todo += [row.removeprefix("odomcorrupt ") for row in following]
    assert any(line.endswith(last) for line in done.values()), done

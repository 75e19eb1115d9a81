"""Options of every command, and what commands print by default."""

import io
import json
import re
import shlex
import shutil
from dataclasses import asdict
from pathlib import Path

import click
import numpy as np
import pytest
from ruamel.yaml import YAML

from odomcorrupt.api.model import Model
from odomcorrupt.cli import cli, run
from odomcorrupt.commands._options import PICTURE
from odomcorrupt.commands._standard import _colours
from odomcorrupt.effects import registry
from odomcorrupt.model.model_file import parse_model
from odomcorrupt.model.presets import PRESETS, suggested
from recordings import FIXTURES

OFFICE, SHORT = str(FIXTURES / "office.mcap"), str(FIXTURES / "office_ros2")
COMMANDS = cli.list_commands(click.Context(cli))


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_the_standard_options(name, invoke):
    command = cli.get_command(click.Context(cli), name)
    words = {word for option in command.params for word in option.opts}
    assert {"-v", "--verbose", "-q", "--quiet", "--json", "--config"} <= words
    assert ("--force" in words) == ("--overwrite" in words)
    assert "-o" in words or name not in ("corrupt", "correct", "assemble", "batch", "simulate", "integrate")
    assert "Usage: odomcorrupt" in invoke([name, "-h"]).out


def test_the_output_is_named_once(tmp_path, invoke):
    assert run([OFFICE, "-o", str(tmp_path / "a.mcap"), "--seed", "1"]) == 0
    assert (tmp_path / "a.mcap").exists()
    assert "both name the output" in invoke([OFFICE, tmp_path / "b.mcap", "-o", tmp_path / "c.mcap"], 2).err


def test_a_verdict_everything_nothing_or_values(tmp_path, invoke):
    def said(*more):
        return invoke([OFFICE, tmp_path / "a.mcap", "--force", "--seed", "1", *more]).err

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
def test_a_seed_is_drawn_and_printed_where_none_is_given(words, tmp_path, invoke):
    seen = set()
    for name in ("a", "b"):
        given = [word.replace("OUT", str(tmp_path / f"{name}.mcap")) for word in words]
        seen.add(json.loads(invoke([*given, "--json"]).out)["seed"])
    assert len(seen) == 2


@pytest.mark.parametrize(("value", "hinted"), [("2", True), ("2%", False), ("-0.6", True), ("0.3", False)])
def test_a_fraction_that_should_be_a_percentage_gets_a_hint(value, hinted, tmp_path, invoke):
    words = [OFFICE, str(tmp_path / "a.mcap"), "--seed", "1", "--effect", f"wheelbase:e={value}"]
    assert ("robots have about 1.5 %" in invoke(words).err) is hinted
    assert invoke([*words, "--overwrite", "-q"]).err == ""


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


def test_an_interrupted_batch_says_what_is_kept(tmp_path, invoke, monkeypatch):
    words = ["batch", OFFICE, str(tmp_path / "runs"), "--output", "trajectories", "--seed", "1"]
    assert run([*words, "--runs", "2"]) == 0

    def interrupted(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("odomcorrupt.api.batch.run_batch", interrupted)
    said = invoke([*words, "--runs", "9"], 130).err
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


def test_defaults_come_from_a_file_and_what_is_typed_wins(tmp_path, monkeypatch, invoke):
    monkeypatch.chdir(tmp_path)
    Path("odomcorrupt.toml").write_text('seed = 5\n[corrupt]\nalpha = [0.1, 0.1, 0.1, 0.1]\n[learn]\nscan = "/scan"\n')
    said = invoke([OFFICE, "a.mcap"]).err
    assert "defaults from odomcorrupt.toml: alpha, seed" in said
    assert "diffusion, alpha 0.1 0.1 0.1 0.1" in said
    assert "seed      5" in said
    said = invoke([OFFICE, "b.mcap", "--preset", "article", "--seed", "6"]).err
    assert "defaults from odomcorrupt.toml: alpha\n" in said
    assert "preset article" in said
    assert "seed      6" in said
    Path("other.toml").write_text("seed = 9\n")
    assert "seed      9" in invoke([OFFICE, "c.mcap", "--config", "other.toml"]).err


@pytest.mark.parametrize(
    ("text", "said"),
    [("sed = 1\n", "sed: no command has this option"),
    ("[corrupt]\nsed = 1\n", "[corrupt] sed: is not an option"),
    ("[corupt]\nseed = 1\n", "[corupt] is not a command"),
    ("seed = \n", "not valid TOML"),
    ('seed = "x"\n', "'x' is not a valid integer")],
)  # fmt: skip
def test_a_wrong_file_of_defaults_is_an_error(text, said, tmp_path, monkeypatch, invoke):
    monkeypatch.chdir(tmp_path)
    Path("odomcorrupt.toml").write_text(text)
    line = invoke([OFFICE, "a.mcap"], 2).err
    assert said in line
    assert line.count("\n") == 1
    assert not Path("a.mcap").exists()


def test_an_effect_without_numbers_has_its_typical_size_and_says_so(tmp_path, invoke):
    said = invoke([OFFICE, tmp_path / "a.mcap", "--effect", "unequal_wheels", "--seed", "1"]).err
    assert "unequal_wheels at its typical size, curvature 0.005 rad/m" in " ".join(said.split())


def test_a_step_may_be_a_distance_alone(tmp_path, invoke):
    numbers = ["--law", "linear", "--alpha", "0.05", "0.1", "0.05", "0.01", "--seed", "1"]
    assert "once per 0.25m,0.2rad" in invoke([OFFICE, tmp_path / "a.mcap", *numbers, "--step", "0.25m"]).err
    assert "once per 0.25m,0.1rad" in invoke([OFFICE, tmp_path / "b.mcap", *numbers, "--step", "0.1rad"]).err


NOISE = ["--alpha", "0.05", "0.02", "0.05", "0.01", "--seed", "1"]
SLIPS = ["--effect", "slip_burst:rate=0.1"]
MAP = ["map", OFFICE, "--resolution", "0.2", *NOISE]


@pytest.fixture(scope="module")
def runs(tmp_path_factory):
    """Return a directory with the paths of a few runs."""
    path = tmp_path_factory.mktemp("batch") / "runs"
    assert run(["batch", OFFICE, str(path), "--runs", "4", "--output", "trajectories", "-q", *NOISE, *SLIPS]) == 0
    return str(path)


def lines_of(invoke, words):
    return invoke(words).out.splitlines()


def require_brief(lines, label, most=8):
    assert lines[0].startswith(label)
    assert len(lines) <= most + 1
    assert not any("1 more line" in line for line in lines)
    assert max(map(len, lines)) <= 80
    assert any(line.startswith("next") for line in lines)
    assert lines[-1].startswith(("next", " "))


@pytest.mark.parametrize("name", registry())
def test_an_effect_is_explained_in_eight_lines(name, invoke):
    require_brief(lines_of(invoke, ["effects", name]), name)


@pytest.mark.parametrize(
    ("words", "label"),
    [(["presets"], "PRESETS"),
    (["effects"], "SYSTEMATIC"),
    (["integrate", SHORT], "INTEGRATED"),
    (["integrate", SHORT, "--twist-noise", "0.2", "0.04", "--runs", "3", "--seed", "1"], "INTEGRATED"),
    (MAP, "THICKER"),
    (["preview", SHORT, "--runs", "2", "--seed", "1"], "DRIFT")],
)  # fmt: skip
def test_a_result_has_eight_lines_all_of_it_nothing_or_values(words, label, invoke):
    # a list of names leaves none out
    require_brief(lines_of(invoke, words), label, most=13 if words == ["effects"] else 8)
    full = lines_of(invoke, [*words, "-v"])
    # more, and not something else: the verdict and the next command, which lists of names have not
    assert len(words) == 1 or (
        any(row.startswith(label) for row in full) and any(row.startswith("next") for row in full)
    )
    assert lines_of(invoke, [*words, "-q"]) == []
    assert json.loads("\n".join(lines_of(invoke, [*words, "--json"])))["schema"] == 2


def test_a_spread_begins_with_whether_it_is_the_predicted_one_and_is_drawn_over_nothing_else(runs, tmp_path, invoke):
    lines = lines_of(invoke, ["spread", runs])
    assert lines[0].startswith(("AS PREDICTED", "WIDER", "NARROWER"))
    require_brief(lines, "")
    assert "4 runs" in lines[0]
    full, picture = lines_of(invoke, ["spread", runs, "-v"]), tmp_path / "out.svg"
    assert any(row.split()[:1] == ["after"] for row in full)
    assert "not predicted: the draws of slip_burst" in "\n".join(full)
    shown = json.loads("\n".join(lines_of(invoke, ["spread", runs, "--json", "-o", str(picture)])))
    assert (shown["runs"], shown["random_effects"], picture.stat().st_size > 1000) == (4, ["slip_burst"], True)
    table = [line.split() for line in full if len(line.split()) == 7 and line[0] == " "]
    assert [float(row[0]) for row in table] == pytest.approx([row["after_m"] for row in shown["rows"]], rel=1e-3)
    assert "--overwrite" in invoke(["spread", runs, "-o", picture], 1).err


def test_the_table_of_a_map_fits_a_hundred_columns(invoke):
    table = [line for line in lines_of(invoke, [*MAP, "-v"]) if " m  " in line and line[:2] == "  "]
    assert len(table) >= 3
    assert max(map(len, table)) <= 100


@pytest.mark.parametrize("target", ["nav2", "robot_localization", "ros2_control"])
def test_parameters_stand_without_their_derivation_unless_it_is_asked_for(target, tmp_path, invoke):
    model = tmp_path / "robot.toml"
    model.write_text("\n".join(lines_of(invoke, ["presets", "article"])) + "\n[[effect]]\nname='side_slip'\nk=0.1\n")
    brief, full = (lines_of(invoke, ["export", str(model), "--to", target, *more]) for more in ([], ["-v"]))
    assert max(map(len, brief + full)) <= 80
    assert len(brief) <= 8 < len(full)
    assert YAML().load("\n".join(brief)) == YAML().load("\n".join(full))
    assert brief[0] == "# not expressed: side_slip (-v says why)"


@pytest.mark.parametrize(
    ("typed", "last"),
    [("info in.mcap", "noisy.mcap"),
    ("batch in.mcap runs --runs 2 --preset typical --output trajectories --seed 1", "preview run_000000.mcap"),
    ("sample -n 50 --seed 2", "density -n 50 --seed 2 --plot density.png"),
    ("integrate in.mcap --twist-noise 0.2 0.04 --seed 1 --runs 3", "--plot errors.png"),
    ("learn mystery.mcap -o robot.toml", "export robot.toml --to ros2_control"),
    ("diagnose mystery.mcap", "sim.bag noisy.bag --model robot.toml"),
    ("batch in.mcap runs --runs 2 --seed 1; score runs --estimate /odom --align origin",
     "info runs/run_000000.mcap; --report page.html"),
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
    assert all(any(line.endswith(one) for line in done.values()) for one in last.split("; ")), done


def test_the_list_has_law_numbers_and_source_of_each(invoke):
    text = invoke(["presets", "-v"]).out
    for preset in PRESETS.values():
        entry = text.split(f"{preset.name}\n", 1)[1].split("\n\n", 1)[0]
        assert f"law {preset.noise.law_name}:" in entry
        assert f"rot_trans {preset.noise.coefficients.rot_trans:.4g}" in entry
        assert all(f"{name} " in entry and f" +- {range_:.2g}" in entry for name, range_ in preset.spread.items())
        assert preset.source in entry
    assert [p["name"] for p in json.loads(invoke(["presets", "--json"]).out)["presets"]] == list(PRESETS)


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_printed_as_a_model_file_of_the_same_model(name, invoke, tmp_path):
    file = tmp_path / "robot.toml"
    file.write_text(invoke(["presets", name]).out)
    read, preset = parse_model(file.read_text()), PRESETS[name]
    assert (read.noise.law_name, read.track_m) == (preset.noise.law_name, preset.track_m)
    assert read.effects == preset.model.effects
    assert read.standard_errors == pytest.approx(dict(preset.spread), rel=1e-2)
    assert asdict(read.noise.coefficients) == pytest.approx(asdict(preset.noise.coefficients), rel=1e-8)
    assert read.source["from"] == preset.source
    assert f"(of {file})" in invoke([OFFICE, tmp_path / "out.mcap", "-v", "--seed", "1", "--model", file]).err


@pytest.mark.parametrize("name", [name for name, preset in PRESETS.items() if preset.spread][::3])
def test_a_batch_draws_a_robot_within_the_range_of_a_preset(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    words = ["--runs", "12", "--seed", "2", "--output", "trajectories"]
    assert run(["batch", OFFICE, "runs", "--preset", name, *words]) == 0
    records = [json.loads(line) for line in Path("runs/manifest.jsonl").read_text().splitlines()]
    preset = PRESETS[name]
    for key, deviation in preset.spread.items():
        mean = 0.0 if "." in key else getattr(preset.noise.coefficients, key)
        drawn = [(record["drawn"][key] - mean) / deviation for record in records]
        assert len(set(drawn)) == 12
        assert 0.4 < np.std(drawn) < 1.8
    # a file printed by the command has the same ranges
    Path("robot.toml").write_text(Model.preset(name).toml())
    assert run(["batch", OFFICE, "again", "--model", "robot.toml", *words]) == 0
    assert Path("again/run_000003.tum").read_bytes() == Path("runs/run_000003.tum").read_bytes()


@pytest.mark.parametrize(
    ("names", "found"),
    [(["/odom", "/scan", "/tf"], ""),
    (["/sensor_state", "turtlebot3_msgs/msg/SensorState"], "turtlebot3-burger"),
    (["/hazard_detection", "irobot_create_msgs/msg/HazardDetectionVector"], "turtlebot4"),
    (["/husky_velocity_controller/odom"], "husky"),
    (["/rosbot_base_controller/odom"], "rosbot"),
    (["base_link -> ir_intensity_left"], "turtlebot4"),
    (["ackermann_msgs/msg/AckermannDriveStamped"], "ackermann"),
    (["/husky_velocity_controller/odom", "/jackal_velocity_controller/odom"], "")],
)  # fmt: skip
def test_topics_types_and_frames_give_a_robot_away(names, found):
    assert suggested(names) == found


def test_info_and_a_run_without_noise_options_suggest_the_robot(tmp_path, invoke):
    bag, still = tmp_path / "husky.mcap", ["--alpha", "0", "0", "0", "0"]
    assert run([OFFICE, str(bag), "-q", *still, "--rename", "/odom=/husky_velocity_controller/odom"]) == 0
    assert "robot     looks like a husky: --preset husky" in invoke(["info", bag]).out
    for words, said in (([], True), (["--preset", "husky"], False)):
        shown = invoke([bag, tmp_path / f"{said}.mcap", "--seed", "1", *words]).err
        assert ("looks like a husky: --preset husky" in shown) is said

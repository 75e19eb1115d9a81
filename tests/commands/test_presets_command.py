"""Presets: listed with law, numbers and source; printed as model files."""

import json
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest

from odomcorrupt.api.model import Model
from odomcorrupt.cli import run
from odomcorrupt.model.model_file import parse_model
from odomcorrupt.model.presets import PRESETS, suggested

OFFICE = str(Path(__file__).parents[2] / "fixtures" / "office.mcap")


def test_the_list_has_law_numbers_and_source_of_each(capsys):
    assert run(["presets", "-v"]) == 0
    text = capsys.readouterr().out
    for preset in PRESETS.values():
        entry = text.split(f"{preset.name}\n", 1)[1].split("\n\n", 1)[0]
        assert f"law {preset.noise.law_name}:" in entry
        assert f"rot_trans {preset.noise.coefficients.rot_trans:.4g}" in entry
        assert all(f"{name} " in entry and f" +- {range_:.2g}" in entry for name, range_ in preset.spread.items())
        assert preset.source in entry
    assert run(["presets", "--json"]) == 0
    assert [p["name"] for p in json.loads(capsys.readouterr().out)["presets"]] == list(PRESETS)


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset_is_printed_as_a_model_file_of_the_same_model(name, capsys, tmp_path):
    assert run(["presets", name]) == 0
    file = tmp_path / "robot.toml"
    file.write_text(capsys.readouterr().out)
    read, preset = parse_model(file.read_text()), PRESETS[name]
    assert (read.noise.law_name, read.track_m) == (preset.noise.law_name, preset.track_m)
    assert read.effects == preset.model.effects
    assert read.standard_errors == pytest.approx(dict(preset.spread), rel=1e-2)
    assert asdict(read.noise.coefficients) == pytest.approx(asdict(preset.noise.coefficients), rel=1e-8)
    assert read.source["from"] == preset.source
    assert run([OFFICE, str(tmp_path / "out.mcap"), "-v", "--seed", "1", "--model", str(file)]) == 0
    assert f"(of {file})" in capsys.readouterr().err


@pytest.mark.parametrize("name", [name for name, preset in PRESETS.items() if preset.spread])
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


def test_info_and_a_run_without_noise_options_suggest_the_robot(tmp_path, capsys):
    bag, still = tmp_path / "husky.mcap", ["--alpha", "0", "0", "0", "0"]
    assert run([OFFICE, str(bag), "-q", *still, "--rename", "/odom=/husky_velocity_controller/odom"]) == 0
    assert run(["info", str(bag)]) == 0
    assert "robot     looks like a husky: --preset husky" in capsys.readouterr().out
    for words, said in (([], True), (["--preset", "husky"], False)):
        assert run([str(bag), str(tmp_path / f"{said}.mcap"), "--seed", "1", *words]) == 0
        assert ("looks like a husky: --preset husky" in capsys.readouterr().err) is said

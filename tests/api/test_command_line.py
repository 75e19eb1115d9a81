"""Values, texts, pictures and bags of the Python interface are those of the command line."""

import json
from pathlib import Path

import pytest

import odomcorrupt as oc
from odomcorrupt.cli import run
from odomcorrupt.errors import OdomCorruptError
from test_refusals import ROBOT

OFFICE = Path(__file__).parents[2] / "fixtures" / "office.mcap"
NOISE = oc.Noise(alpha=(0.05, 0.02, 0.05, 0.01))
ALPHA = ["--alpha", "0.05", "0.02", "0.05", "0.01"]
FRAMES = ["--odom", "odom", "--odom-frame", "odom", "--base-frame", "base_link"]
READS = {
    "preview": (
        lambda: oc.preview(OFFICE, NOISE, seed=4, run=3, runs=2),
        ["preview", str(OFFICE), *ALPHA, "--seed", "4", "--run", "3", "--runs", "2"],
    ),
    "preview of a topic": (
        lambda: oc.preview(OFFICE, runs=2, seed=5, odom_topic="odom", odom_frame="odom", base_frame="base_link"),
        ["preview", str(OFFICE), "--runs", "2", "--seed", "5", *FRAMES],
    ),
    "spread": (lambda: oc.spread("runs"), ["spread", "runs"]),
    "info": (lambda: oc.info(OFFICE), ["info", str(OFFICE)]),
    "info of a frame": (
        lambda: oc.info(OFFICE, odom_topic="odom", odom_frame="map", base_frame="base"),
        ["info", str(OFFICE), "--odom", "odom", "--odom-frame", "map", "--base-frame", "base"],
    ),
}


MODEL_FILE = f"""{ROBOT}[robot]
track = 0.4
[[effect]]
name = "wheelbase"
e = 0.02
[[effect]]
name = "gyro_scale"
e = 0.01
"""
STATED = {
    "effects": (oc.list_effects, ["effects"]),
    "one effect": (lambda: oc.describe_effect("region_slip"), ["effects", "region_slip"]),
    "presets": (oc.list_presets, ["presets"]),
    "conversion": (
        lambda: oc.convert_alpha(oc.Noise(alpha=(0.2, 0.1, 0.2, 0.2), law="quadratic", step="0.25m"), "diffusion"),
        ["convert-alpha", "0.2", "0.1", "0.2", "0.2", "--from", "quadratic", "--step", "0.25m", "--to", "diffusion"],
    ),
    "wheels": (
        lambda: oc.export_parameters("robot.toml", "ros2_control"),
        ["export", "robot.toml", "--to", "ros2_control"],
    ),
    "alphas": (
        lambda: oc.export_parameters("robot.toml", "nav2", update_min_d=0.1, turn="spot"),
        ["export", "robot.toml", "--to", "nav2", "--update-min-d", "0.1", "--turn", "spot"],
    ),
    "covariances": (
        lambda: oc.export_parameters("robot.toml", "robot_localization", speed=0.3, controller="base"),
        ["export", "robot.toml", "--to", "robot_localization", "--speed", "0.3", "--controller", "base"],
    ),
    "particles": (
        lambda: oc.sample_along(OFFICE, NOISE, runs=5, seed=2, every_m=4.0),
        ["sample", str(OFFICE), *ALPHA, "-n", "5", "--seed", "2", "--every", "4"],
    ),
}


@pytest.mark.parametrize("name", [*READS, *STATED])
def test_values_texts_and_pictures_are_those_of_the_command_line(name, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("robot.toml").write_text(MODEL_FILE)
    if name == "spread":
        oc.batch(OFFICE, "runs", model=NOISE, runs=3, seed=1, output="trajectories")
    call, words = (READS | STATED)[name]
    result = call()
    assert run([*words, "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == json.loads(json.dumps(result.to_dict()))
    assert run([*words, "-v"]) == 0
    assert capsys.readouterr().out.startswith(result.details() + "\n")
    assert len(result.rows()) > 3 * (name in READS)
    assert run(words) == 0
    shown, own = (text.partition("\nnext")[0].rstrip().splitlines() for text in (capsys.readouterr().out, str(result)))
    shown = [line for line in shown if "more line" not in line]  # the next command takes a line or two of eight
    if words[0] != "export":  # which prints the YAML, condensed
        assert own[: len(shown)] == shown
    if words[0] in ("preview", "spread"):
        result.plot("ours.svg")
        assert run([*words, "-o", "theirs.svg"]) == 0
        assert (tmp_path / "ours.svg").read_bytes() == (tmp_path / "theirs.svg").read_bytes()
    elif words[0] == "info":
        with pytest.raises(OdomCorruptError, match="no picture of a result of class Info"):
            result.plot("ours.svg")


def test_an_effect_of_the_wheels_is_exported_beside_one_that_cannot_be(tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(MODEL_FILE)
    exported = oc.export_parameters(path, "ros2_control")
    assert exported.result.left_out == ("gyro_scale",)
    assert exported.result.values["wheel_separation_multiplier"] == pytest.approx(1.02)
    assert exported.save(tmp_path / "wheels.yaml").read_text() == exported.details() + "\n"
    with pytest.raises(OdomCorruptError, match="overwrite=True"):
        exported.save(tmp_path / "wheels.yaml")


def test_an_overlay_is_assembled_to_the_bytes_of_the_whole_bag(tmp_path):
    runs = oc.batch(OFFICE, tmp_path / "runs", model=NOISE, runs=1, seed=7, output="overlay")
    whole = oc.batch(OFFICE, tmp_path / "whole", model=NOISE, runs=1, seed=7, output="full")
    done = oc.assemble(runs.paths[0], tmp_path / "ours.mcap")
    assert (done.messages, done.original) == (6000, OFFICE)
    assert done.path.read_bytes() == whole.paths[0].read_bytes()

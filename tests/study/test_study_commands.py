"""Commands of the study on simulated recordings: known values are not reported missing; clocks keep their names."""

import json
import re

import pytest

from odomcorrupt.api.findings import Comparison
from odomcorrupt.cli import run

pytestmark = pytest.mark.slow


def simulated(path, *words):
    assert run(["simulate", str(path), "-q", *words]) == 0
    return str(path)


def test_a_mounting_that_the_model_has_is_not_missing(tmp_path, capsys):
    bag = simulated(tmp_path / "arm.mcap", "--effect", "lever_arm:x=0.15,y=0.05", "--seed", "4", "--duration", "200")
    assert run(["fit", bag, "-o", str(tmp_path / "arm.toml")]) == 0
    assert "lever_arm" in capsys.readouterr().out
    assert run(["diagnose", bag, str(tmp_path / "arm.toml"), "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["verdict"] == "complete"
    assert "lever_arm" not in [one["effect"] for one in found["found"]]


def test_learned_and_held_out_recordings_keep_their_own_clocks(tmp_path, capsys):
    late = ("--effect", "time_offset", "--robot", "5", "--duration", "80")
    bags = [simulated(tmp_path / f"s{seed}.mcap", *late, "--seed", str(seed)) for seed in (1, 2, 3)]
    report, model = tmp_path / "page.html", str(tmp_path / "r.toml")
    assert run(["learn", *bags[:2], "--judge", bags[2], "--report", str(report), "-o", model]) == 0
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith("COMPLETE  the robot's model is complete; the odometry is stamped ")
    assert len(said) <= 9
    page = report.read_text()
    assert "<h1>What is missing: s1.mcap, s2.mcap, evaluated on s3.mcap</h1>" in page
    assert re.findall(r"<p>of (s\d\.mcap)</p>", page) == ["s1.mcap", "s2.mcap"]


def test_a_model_that_makes_held_out_data_worse_is_not_written(tmp_path, capsys, monkeypatch):
    model = tmp_path / "robot.toml"
    each = [("--effect", f"wheel_scale:e={e}", "--seed", "5", "--duration", "60") for e in (-0.03, 0.03)]
    bags = [simulated(tmp_path / f"{i}.mcap", *words) for i, words in enumerate(each)]
    for words in (["fit", *bags, "--add", "wheel_scale"], ["learn", bags[0]]):
        if words[0] == "learn":  # it selects none of the kind
            monkeypatch.setattr(Comparison, "worse", property(lambda _: True))
        assert run([*words, "-o", str(model)]) == 1
        assert not model.exists()
        assert re.search("10 s error(?s:.*)robot.toml: not written.* tried", "".join(capsys.readouterr()))

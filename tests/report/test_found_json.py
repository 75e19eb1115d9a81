"""JSON and report of diagnose: the schema of the page, finite numbers, what is open; in a real browser, too."""

from __future__ import annotations

import json
import re
from html import unescape
from pathlib import Path

import pytest
from test_report import parsed_page, shown

from odomcorrupt.cli import run
from odomcorrupt.study.select.confidence import Evidence, confidence

PAGE = (Path(__file__).parents[2] / "docs" / "json.md").read_text(encoding="utf8")


@pytest.fixture(scope="module")
def printed(case, diagnosed, tmp_path_factory):
    """What `diagnose --json` prints of a short office drive with one wheel larger, and what it writes beside it."""
    folder = tmp_path_factory.mktemp("printed")
    files = {"drive": folder / "next.mcap", "report": folder / "found.html"}
    words = [w for flag, path in files.items() for w in (f"--{flag}", str(path))]
    out = folder / "out.json"
    with pytest.MonkeyPatch.context() as patch, out.open("w") as stream:
        patch.setattr("sys.stdout", stream)
        patch.setattr("odomcorrupt.study.pipeline.learn", lambda *_args, **_named: diagnosed.search)
        patch.setattr("odomcorrupt.study.pipeline.sequence_comparison", lambda *_args, **_clocks: diagnosed.sequence)
        assert run(["diagnose", str(case.bag), "--track", str(case.recording.track_m), "--json", *words]) == 0
    return json.loads(out.read_text(), parse_constant=pytest.fail), files


def test_the_schema_is_that_of_the_page(printed):
    found, _ = printed
    section = PAGE.split("## `diagnose --json`", 1)[1].split("\n## ", 1)[0]
    rows = [re.findall(r"`([^`]+)`", line.split("|")[1]) for line in section.splitlines() if line.startswith("| `")]
    named = {code for codes in rows for code in codes}
    assert set(found) - {"schema"} == {code for code in named if "[" not in code and "." not in code}
    assert found["schema"] == 2
    entry = found["found"][0]
    assert {f"found[].{key}" for key in entry} <= named | {"found[].effect", "found[].kind"}


def test_the_cause_is_found_with_its_numbers(printed, case):
    found, _ = printed
    assert found["verdict"] == "missing"
    entry = found["found"][0]
    assert (entry["effect"], entry["kind"]) == ("unequal_wheels", "effect")
    curvature = entry["parameters"]["curvature"]
    assert curvature["unit"] == "rad/m"
    assert abs(curvature["value"] + 0.0133) < 4.0 * curvature["standard_error"]
    assert 0.9 < entry["confidence"] < 1.0
    for key in ("rmse_10m", "rmse_10s"):
        before, after = entry["held_out"][key]
        assert after < before
    # half of this drive is no 50 m
    assert entry["held_out"]["rmse_50m"] == [None, None]
    assert entry["held_out"]["nats_per_m"][1] > entry["held_out"]["nats_per_m"][0]
    assert found["ladder"][0]["rmse_10s"] == entry["held_out"]["rmse_10s"][0]
    assert found["ladder"][1]["model"] == "+ unequal_wheels"
    assert found["candidates"][0]["effect"] == "unequal_wheels"


def test_what_is_open_is_reported_with_a_drive(printed):
    found, files = printed
    for one in found["not_testable"]:
        assert one["why"]
        assert one["drive"]
    assert all(one["size"] > 0.0 for one in found["detectable"])
    seen = {one["effect"] for one in found["detectable"]}
    assert not seen & {one["effect"] for one in found["not_testable"]}
    assert files["drive"].exists() == (found["next_drive"] is not None)


def test_confidence_falls_with_rivals_with_what_is_left_and_with_little_evidence():
    plain = confidence(Evidence(50.0))
    assert plain > 0.99
    assert confidence(Evidence(50.0, (49.5,))) == pytest.approx(1.0 / (2.0 - 0.393 + 0.005), abs=0.02)
    assert confidence(Evidence(50.0, (49.0, 20.0))) > confidence(Evidence(50.0, (49.9, 20.0)))
    assert confidence(Evidence(50.0, (), 100.0)) < 0.4
    assert plain > confidence(Evidence(50.0, correlated=50.0)) > confidence(Evidence(50.0, left=50.0))
    assert confidence(Evidence(1.0)) < 0.75
    assert confidence(Evidence(-1.0)) == 0.0


def test_the_report_is_whole_small_and_says_what_is_missing(printed):
    found, files = printed
    page = files["report"].read_text(encoding="utf8")
    parsed = parsed_page(page)
    assert parsed.tags.count("script") == 2  # the data, and the one script that the policy admits
    text = unescape(page)
    assert "missing: unequal_wheels" in text.lower()
    assert "--add unequal_wheels" in text
    for one in found["not_testable"]:
        assert one["why"] in text
    assert parsed.tags.count("img") == 3 + bool(found["unknown"]) + bool(found["next_drive"])
    assert "nan" not in unescape(re.sub(r'src="[^"]*"', "", page)).lower().split()


@pytest.mark.slow
def test_a_real_browser_shows_the_report(printed, tab, tmp_path):
    page = tmp_path / "found.html"
    page.write_bytes(printed[1]["report"].read_bytes())
    assert shown(tab, page) > 1500

"""Scores of a batch: estimates beside the runs, in them, as TUM and from TF; what is missing is never dropped."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

import odomcorrupt as oc
from odomcorrupt.batching.sinks import format_tum, read_tum
from odomcorrupt.cli import run
from odomcorrupt.scoring.errors import Limits, ScoreError
from odomcorrupt.scoring.run import score

OFFICE = Path(__file__).parents[2] / "fixtures" / "office.mcap"
NOISE = ("--alpha", "0.05", "0.02", "0.05", "0.01")


@pytest.fixture(scope="module")
def batch(tmp_path_factory):
    folder = tmp_path_factory.mktemp("batch")
    for runs, output in ((10, "trajectories"), (2, "full")):
        words = [str(OFFICE), str(folder / output), "--runs", str(runs), *NOISE, "--seed", "7", "--output", output]
        assert run(["batch", *words]) == 0
    return folder


@pytest.fixture
def estimates(batch, tmp_path):
    """Return a directory with estimates of ten runs: a tenth of the odometry's error is left."""
    clean = read_tum(batch / "trajectories" / "clean.tum")
    for path in (batch / "trajectories").glob("run_*.tum"):
        own = read_tum(path)
        (tmp_path / path.name).write_bytes(format_tum(own.stamps_ns, clean.xyt + 0.1 * (own.xyt - clean.xyt)))
    return tmp_path


def spoil(path, rows=slice(None), shift_m=0.0, shift_ns=0):
    own = read_tum(path)
    xyt = own.xyt.copy()
    xyt[len(xyt) // 2 :, 0] += shift_m
    path.write_bytes(format_tum(own.stamps_ns[rows] + shift_ns, xyt[rows]))


def test_a_tenth_of_the_drift_is_a_tenth_of_the_error(batch, estimates):
    report = score(batch / "trajectories", outputs=estimates, align="none")
    whole = score(batch / "trajectories", outputs=batch / "full", estimate="/odom", align="none")
    assert [one.status for one in report.runs] == ["ok"] * 10
    assert [one.status for one in whole.runs[:3]] == [*[one.status for one in whole.runs[:2]], "missing"]
    for part, full in zip(report.runs[:2], whole.runs[:2], strict=True):
        assert part.metrics["ate_m"] == pytest.approx(0.1 * full.metrics["ate_m"], rel=1e-3)
        assert full.metrics["end_m"] == pytest.approx(full.drift_end_m, rel=1e-3)


def test_the_run_itself_may_hold_the_estimate_as_a_topic_or_in_tf(batch):
    topic, edge = (
        score(batch / "full", name, align="origin", limits=Limits(lost_m=10.0))
        for name in ("/odom", "/tf:odom.base_link")
    )
    for one, other in zip(topic.runs, edge.runs, strict=True):
        assert one.metrics["ate_m"] == pytest.approx(other.metrics["ate_m"], rel=1e-3)
        assert np.isnan(other.metrics["nees"])
    assert 0.2 < topic.summary("nees").median.value < 5.0


def test_what_is_wrong_with_a_run_is_said_and_counted_only_on_demand(batch, estimates):
    spoil(estimates / "run_000001.tum", rows=slice(0, 1200))
    (estimates / "run_000002.tum").unlink()
    spoil(estimates / "run_000003.tum", shift_ns=10**15)
    (estimates / "run_000004.tum").write_text("nothing of the kind\n")
    spoil(estimates / "run_000005.tum", shift_m=3.0)
    (estimates / "run_000006.tum").write_text("")
    report = score(batch / "trajectories", outputs=estimates, align="none")
    statuses = [one.status for one in report.runs]
    assert statuses[:8] == ["ok", "partial", "missing", "unreadable", "unreadable", "lost", statuses[6], "ok"]
    assert statuses[6] in ("missing", "unreadable")
    assert all(one.reason for one in report.runs if one.status != "ok")
    assert "covers" in report.runs[1].reason
    assert "no time in common" in report.runs[3].reason
    assert report.runs[5].failure.t_s == pytest.approx(30.0, abs=0.2)
    assert (len(report.counted), sum(report.failed(one) for one in report.runs)) == (5, 1)
    assert report.summary("ate_m").n == 5
    strict = score(batch / "trajectories", outputs=estimates, align="none", count_missing=True)
    assert (len(strict.counted), sum(strict.failed(one) for one in strict.runs)) == (10, 6)


def test_no_estimate_at_all_and_no_batch_are_errors(batch, tmp_path):
    with pytest.raises(ScoreError, match="none of 10 runs"):
        score(batch / "trajectories", outputs=tmp_path)
    with pytest.raises(ScoreError, match="holds no batch"):
        score(tmp_path)


def test_two_files_that_could_be_meant_are_named(batch, estimates):
    shutil.copy(estimates / "run_000000.tum", estimates / "run_000000_slam.tum")
    report = score(batch / "trajectories", outputs=estimates)
    assert report.runs[0].status == "unreadable"
    assert "run_000000.tum, run_000000_slam.tum" in report.runs[0].reason


def test_a_sweep_is_one_report(tmp_path):
    words = [str(OFFICE), str(tmp_path / "runs"), "--runs", "2", *NOISE, "--seed", "7", "--output", "overlay"]
    assert run(["batch", *words, "--sweep", "alpha-scale=0.5,2"]) == 0
    report = score(tmp_path / "runs", "/odom", align="origin", limits=Limits(lost_m=1e3))
    assert [one.name for one in report.runs] == [
        f"alpha-scale={scale}/run_{number:06d}" for scale in ("0.5", "2") for number in (0, 1)
    ]
    low, high = (np.mean([one.drift for one in report.runs[i : i + 2]]) for i in (0, 2))
    assert high > 2.0 * low


@pytest.mark.slow
def test_the_command_writes_a_baseline_and_turns_red_against_it(batch, estimates, tmp_path, capsys):
    words = ["score", str(batch / "trajectories"), "--outputs", str(estimates), "--align", "none"]
    base, page, picture = (tmp_path / name for name in ("last.json", "page.html", "score.png"))
    assert run([*words, "--save", str(base), "--report", str(page), "-o", str(picture), "--each"]) == 0
    text = capsys.readouterr().out
    assert "10 runs, 0 of 10 counted ones failed" in text
    assert text.count("run_0000") == 10
    assert page.read_text().count("<img") == 3
    assert picture.stat().st_size > 10_000
    gate = ["--baseline", str(base), "--fail-if", "ate_p90 +20%"]
    assert run([*words, *gate]) == 0
    clean = read_tum(batch / "trajectories" / "clean.tum")
    for path in estimates.glob("run_*.tum"):
        own = read_tum(path)
        path.write_bytes(format_tum(own.stamps_ns, clean.xyt + 1.5 * (own.xyt - clean.xyt)))
    capsys.readouterr()
    assert run([*words, *gate]) == 1
    assert "FAILED" in capsys.readouterr().out
    assert run([*words, *gate, "--json"]) == 1
    said = capsys.readouterr()
    table = json.loads(said.out)
    assert table["verdicts"][0]["comparison"]["ratio"] == pytest.approx(1.5, rel=1e-3)
    assert "FAILED" in said.err


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--fail-if", "ate_p90 +20%"], 1, "--baseline"),
        (["--fail-if", "ate +"], 1, "not understood"),
        (["--baseline", "BASE"], 2, "--fail-if"),
        (["--fail-if", "ate_p90 +20%", "--baseline", "BASE"], 1, "not a result of score"),
        (["-o", "score.gif"], 2, "ends in .gif; write .png, .svg or .pdf"),
        (["--lost", "nan"], 2, "metres"),
        (["--truth", "/nowhere"], 1, "/nowhere"),
    ],
)
def test_wrong_words_are_refused_in_one_line(batch, estimates, tmp_path, capsys, words, code, said):
    (tmp_path / "base.json").write_text("[]")
    given = [word.replace("BASE", str(tmp_path / "base.json")) for word in words]
    assert run(["score", str(batch / "trajectories"), "--outputs", str(estimates), *given]) == code
    error = capsys.readouterr().err
    assert said in error
    assert error.count("\n") == 1


def test_a_score_is_eight_lines_and_begins_with_what_failed(batch, estimates, capsys):
    words = ["score", str(batch / "trajectories"), "--outputs", str(estimates), "--align", "none"]
    for label, code, gate in (("HELD", 0, []), ("FAILED", 1, ["--fail-if", "ate_median > 0"])):
        assert run([*words, *gate]) == code
        lines = capsys.readouterr().out.splitlines()
        assert lines[0].startswith(label)
        assert len(lines) <= 8
        assert max(map(len, lines)) <= 80
        assert any(line.startswith("next") for line in lines)
        assert any(line.startswith("gate") for line in lines) == bool(gate)


def test_the_json_page_names_every_key(batch, estimates, capsys):
    spoil(estimates / "run_000005.tum", shift_m=3.0)
    assert run(["score", str(batch / "trajectories"), "--outputs", str(estimates), "--json"]) == 0
    table = json.loads(capsys.readouterr().out)
    page = (Path(__file__).parents[2] / "docs" / "json.md").read_text()
    section = page.split("## `score --json`", 1)[1].split("\n## ", 1)[0]
    missing = {key for key in keys_of(table) if f"`{key}`" not in section and f"`{key}[]`" not in section}
    assert missing == {"schema"}


def keys_of(value):
    if isinstance(value, dict):
        return set(value).union(*map(keys_of, value.values()))
    return set().union(*map(keys_of, value)) if isinstance(value, list) else set()


def test_a_score_from_python_is_small_to_print_and_has_a_gate(batch, estimates, tmp_path):
    result = oc.score(batch / "trajectories", outputs=estimates, align="none")
    assert repr(result).startswith("<Score: HELD ")
    assert len(repr(result)) < 120
    assert len(str(result).splitlines()) <= 8
    assert [row["run"] for row in result.rows()] == list(range(10))
    assert result.rows()[3]["ate_m"] == result.result.runs[3].metrics["ate_m"]
    assert not result.check(["ate_p90 +20%"], baseline=result.to_dict()).failed
    with pytest.raises(ScoreError, match="but origin in the baseline; score both with the same"):
        result.check(["ate_p90 +20%"], baseline=result.to_dict() | {"align": "origin"})
    assert result.check(["ate_median > 0"]).failed
    result.plot(tmp_path / "score.png")

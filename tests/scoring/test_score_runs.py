"""Scores of the runs of a batch, errors of a path, and the gate of a pipeline."""

import csv
import json
import re
import shlex
import shutil
import xml.etree.ElementTree as ET

import numpy as np
import pytest

import odomcorrupt as oc
from evo_oracle import as_evo, evo_metrics
from odomcorrupt.batching.sinks import format_tum, read_tum
from odomcorrupt.cli import run
from odomcorrupt.geometry.se2 import Increments, accumulate, compose
from odomcorrupt.geometry.trajectory import Trajectory
from odomcorrupt.scoring.errors import Limits, ScoreError, path_errors
from odomcorrupt.scoring.gate import _signed_rank, check, compare_paired, parse_rule, typical_of
from odomcorrupt.scoring.run import breakdown, growth, score, sections, summarise
from recordings import OFFICE, ROOT

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
    return localise(batch / "trajectories", tmp_path, 0.1)


def localise(runs, folder, part):
    clean = read_tum(runs / "clean.tum")
    for path in runs.glob("run_*.tum"):
        own = read_tum(path)
        (folder / path.name).write_bytes(format_tum(own.stamps_ns, clean.xyt + part * (own.xyt - clean.xyt)))
    return folder


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


def test_a_batch_of_trajectories_is_scored_itself_where_no_run_has_an_estimate(batch, estimates, tmp_path, capsys):
    runs = shutil.copytree(batch / "trajectories", tmp_path / "runs")
    whole = score(batch / "full", "/odom", align="none")
    assert run(["score", str(runs), "--align", "none"]) == 0
    assert "SCORED  0 of 10 runs failed; estimate: the odometry of the runs itself" in capsys.readouterr().out
    own = score(runs, align="none")
    assert own.runs[0].metrics["ate_m"] == pytest.approx(whole.runs[0].metrics["ate_m"], rel=1e-3)
    for words in (["--estimate", "/odom"], ["--outputs", str(batch / "full")]):
        assert run(["score", str(runs), *words]) == 1
    # beside one estimate the odometry of the other runs is none: they crashed
    shutil.copy(estimates / "run_000003.tum", runs / "run_000003_slam.tum")
    assert [one.status for one in score(runs, align="none").runs] == ["missing"] * 3 + ["ok"] + ["missing"] * 6


def test_what_is_wrong_with_a_run_is_said_and_counted(batch, estimates):
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
    assert report.failed == 6
    found = report.summary("ate_m")
    assert (found.n, found.median.value, found.max) == (10, np.inf, np.inf)


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


@pytest.fixture(scope="module")
def sweep(tmp_path_factory):
    runs = tmp_path_factory.mktemp("sweep") / "runs"
    words = [str(OFFICE), str(runs), "--runs", "2", *NOISE, "--seed", "7", "--output", "overlay"]
    assert run(["batch", *words, "--sweep", "alpha-scale=0.5,2"]) == 0
    return runs


def test_a_sweep_is_one_report(sweep):
    report = score(sweep, "/odom", align="origin", limits=Limits(lost_m=1e3))
    assert [one.name for one in report.runs] == [
        f"alpha-scale={scale}/run_{number:06d}" for scale in ("0.5", "2") for number in (0, 1)
    ]
    low, high = report.points
    assert (low.runs[0].point, high.runs[0].point) == ("alpha-scale=0.5", "alpha-scale=2")
    assert (len(low.runs), low.failed) == (2, 0)
    assert high.drift > 2.0 * low.drift
    assert low.summary("ate_m").p90.value == pytest.approx(
        np.quantile([one.metrics["ate_m"] for one in report.runs[:2]], 0.9), rel=1e-9
    )


def test_a_sweep_is_a_table_of_points_everywhere(sweep, tmp_path, invoke):
    files = {name: tmp_path / name for name in ("t.csv", "t.md", "t.xml", "t.png")}
    options = zip(("--csv", "--markdown", "--junit", "--plot"), files.values(), strict=True)
    given = [word for option, file in options for word in (option, str(file))]
    gate = ["--fail-if", "ate_median > 0.001", "--fail-if", "lost > 99%"]
    shown = invoke(["score", sweep, "--estimate", "/odom", "--align", "origin", *given, *gate], 1).out
    head = next(line for line in shown.splitlines() if line.startswith("points"))
    assert head.split() == ["points", "drift", "runs", "lost", "median", "ATE", "p90", "point"]
    rows = list(csv.DictReader(files["t.csv"].read_text().splitlines()))
    assert [row["point"] for row in rows] == ["alpha-scale=0.5", "alpha-scale=2"]
    text = files["t.md"].read_text()
    assert text.startswith("## FAILED: /odom")
    for row in rows:
        for value in (f"{float(row['median_ate_m']):.3g} m", f"{float(row['p90_ate_m']):.3g} m", row["point"]):
            assert value in shown
            assert value in text
    suite = ET.fromstring(files["t.xml"].read_text())  # noqa: S314 - our own file
    assert (suite.get("tests"), suite.get("failures")) == ("3", "1")
    (failure,) = suite.iter("failure")
    assert "seed 7" in failure.text
    assert "run_000000" in failure.text
    assert files["t.png"].stat().st_size > 10_000


def test_the_estimate_of_the_recording_is_no_estimate_of_its_runs(batch, estimates, invoke):
    for path in estimates.glob("run_*.tum"):
        shutil.copy(batch / "trajectories" / "run_000000.tum", path)
    words = ["score", str(batch / "trajectories"), "--outputs", str(estimates)]
    for gate, code, first in (([], 0, "IDENTICAL"), (["--fail-if", "ate_median > 9"], 1, "FAILED")):
        said = invoke([*words, *gate], code).out
        assert said.startswith(first)
        assert "your localisation was not run again" in re.sub(r"\s+", " ", said)


def test_poses_in_two_frames_are_subtracted_on_demand_only(batch, tmp_path, invoke):
    (tmp_path / "truth.tum").write_bytes((batch / "full" / "clean.tum").read_bytes())
    shutil.copytree(batch / "full", tmp_path / "runs")
    shutil.rmtree(tmp_path / "runs" / ".parts")
    records = tmp_path / "runs" / "manifest.jsonl"
    records.write_text(records.read_text().replace('"odom_frame": "odom"', '"odom_frame": "wheels"'))
    words = ["score", str(tmp_path / "runs"), "--estimate", "/odom"]
    said = invoke([*words, "--align", "none"], 1).err
    for part in ("frame odom", "truth in wheels", "--truth", "--align rigid"):
        assert part in said
    for fine in (["same"], ["rigid"], ["none", "--truth-bag", str(tmp_path / "truth.tum")]):
        assert run([*words, "--align", *fine]) == 0


@pytest.mark.slow
def test_the_command_writes_a_baseline_and_turns_red_against_it(batch, estimates, tmp_path, invoke):
    words = ["score", str(batch / "trajectories"), "--outputs", str(estimates), "--align", "none"]
    base, page, picture = (tmp_path / name for name in ("last.json", "page.html", "score.png"))
    text = invoke([*words, "--save", base, "--report", page, "-o", picture, "-v"]).out
    assert "0 of 10 runs failed" in text
    assert text.count("run_0000") == 10
    assert page.read_text().count("<img") == 3
    assert picture.stat().st_size > 10_000
    gate = ["--baseline", str(base), "--fail-if", "ate_p90 +20%"]
    assert run([*words, *gate]) == 0
    localise(batch / "trajectories", estimates, 0.15)
    assert "FAILED" in invoke([*words, *gate], 1).out
    said = invoke([*words, *gate, "--json"], 1)
    table = json.loads(said.out)
    assert table["verdicts"][0]["comparison"]["ratio"] == pytest.approx(1.5, rel=1e-3)
    assert "FAILED" in said.err


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [(["--fail-if", "ate_p90 +20%"], 1, "--baseline"),
    (["--fail-if", "ate +"], 1, "not understood"),
    (["--baseline", "BASE"], 2, "--fail-if"),
    (["--fail-if", "ate_p90 +20%", "--baseline", "BASE"], 1, "not a result of score"),
    (["-o", "score.gif"], 2, "ends in .gif; write .json, .png, .svg or .pdf"),
    (["--lost", "nan"], 2, "metres"),
    (["--truth", "/nowhere"], 1, "Name another with --truth"),
    (["--outputs", "FULL", "--estimate", "/nowhere"], 1, "Name another with --estimate")],
)  # fmt: skip
def test_wrong_words_are_refused_in_one_line(batch, estimates, tmp_path, invoke, words, code, said):
    (tmp_path / "base.json").write_text("[]")
    given = [word.replace("BASE", str(tmp_path / "base.json")).replace("FULL", str(batch / "full")) for word in words]
    error = invoke(["score", batch / "trajectories", "--outputs", estimates, *given], code).err
    assert said in error
    assert error.count("\n") == 1


def test_the_first_word_is_the_gates_result_and_the_exit_code(batch, estimates, capsys):
    words = ["score", str(batch / "trajectories"), "--outputs", str(estimates), "--align", "none"]
    (estimates / "run_000001.tum").unlink()
    passing, failing = ["--fail-if", "ate_median > 9"], ["--fail-if", "ate_median > 0"]
    for label, code, gate in (("SCORED", 0, []), ("PASSED", 0, passing), ("FAILED", 1, failing)):
        assert run([*words, *gate, "--markdown", str(estimates.parent / f"{label}.md")]) == code
        lines = [line for line in capsys.readouterr().out.splitlines() if not line.startswith("wrote ")]
        assert lines[0].startswith(label)
        assert "1 of 10 runs failed (1 missing)" in lines[0]
        assert len(lines) <= {"SCORED": 9, "PASSED": 11, "FAILED": 21}[label]
        following = next(i for i, line in enumerate(lines) if line.startswith("next"))
        said = " ".join(line[8:].removesuffix("\\").strip() for line in lines[following:])
        assert said == shlex.join(["odomcorrupt", *words, *gate, "--report", "page.html"])
        # a path is not divided, however long
        assert max(len(line) for line in lines if str(batch.parent) not in line) <= 80
        assert any(line.startswith("gate") for line in lines) == bool(gate)


def test_the_json_page_names_every_key(batch, estimates, invoke):
    spoil(estimates / "run_000005.tum", shift_m=3.0)
    table = json.loads(invoke(["score", batch / "trajectories", "--outputs", estimates, "--json"]).out)
    page = (ROOT / "docs" / "json.md").read_text()
    section = page.split("## `score --json`", 1)[1].split("\n## ", 1)[0]
    missing = {key for key in keys_of(table) if f"`{key}`" not in section and f"`{key}[]`" not in section}
    assert missing == {"schema"}


def keys_of(value):
    if isinstance(value, dict):
        return set(value).union(*map(keys_of, value.values()))
    return set().union(*map(keys_of, value)) if isinstance(value, list) else set()


def test_a_score_from_python_is_small_to_print_and_has_a_gate(batch, estimates, tmp_path):
    result = oc.score(batch / "trajectories", outputs=estimates, align="none")
    assert repr(result).startswith("<Score: SCORED ")
    assert len(repr(result)) < 120
    assert len(str(result).splitlines()) <= 8
    assert [row["run"] for row in result.rows()] == list(range(10))
    assert result.rows()[3]["ate_m"] == result.result.runs[3].metrics["ate_m"]
    assert not result.check(["ate_p90 +20%"], baseline=result.to_dict()).failed
    with pytest.raises(ScoreError, match="but origin in the baseline; score both with the same"):
        result.check(["ate_p90 +20%"], baseline=result.to_dict() | {"align": "origin"})
    assert result.check(["ate_median > 0"]).failed
    result.plot(tmp_path / "score.png")


N = 1200
STAMPS = 10**18 + np.arange(N) * 100_000_000


def truth_path():
    turn = 0.03 * np.sin(np.arange(N - 1) / 40.0)
    return accumulate(np.array([3.0, -2.0, 1.0]), Increments(np.full(N - 1, 0.04), np.zeros(N - 1), turn))


def estimate_path(seed):
    rng = np.random.default_rng(seed)
    draws = rng.standard_normal((N, 3)) * [0.02, 0.02, 0.01] + np.linspace(0.0, 0.5, N)[:, None] * [1.0, -0.5, 0.3]
    return compose(np.array([-7.0, 4.0, -1.2]), compose(truth_path(), draws))


def trajectory(xyt, stamps=STAMPS):
    return Trajectory(stamps, xyt)


@pytest.mark.parametrize("align", ["rigid", "origin", "none"])
def test_ate_and_rpe_are_evos_for_every_alignment(align):
    metrics = evo_metrics()
    truth, own = truth_path(), estimate_path(1)
    reference, estimate = as_evo(truth, STAMPS), as_evo(own, STAMPS)
    if align == "rigid":
        estimate.align(reference, correct_scale=False)
    elif align == "origin":
        estimate.align_origin(reference)
    ape = metrics.APE(metrics.PoseRelation.translation_part)
    ape.process_data((reference, estimate))
    heading = metrics.APE(metrics.PoseRelation.rotation_angle_rad)
    heading.process_data((reference, estimate))
    rpe = metrics.RPE(metrics.PoseRelation.translation_part, delta=1.0, delta_unit=metrics.Unit.meters, all_pairs=False)
    rpe.process_data((reference, estimate))
    found = path_errors(trajectory(own), trajectory(truth), align=align).metrics()
    assert found["ate_m"] == pytest.approx(ape.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)
    assert found["ate_rad"] == pytest.approx(heading.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)
    assert found["max_m"] == pytest.approx(ape.get_statistic(metrics.StatisticsType.max), rel=1e-6)
    assert found["end_m"] == pytest.approx(ape.error[-1], rel=1e-6)
    assert found["rpe_m"] == pytest.approx(rpe.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)


def test_the_10_s_error_is_evos_rpe_of_a_hundred_frames():
    metrics = evo_metrics()
    rpe = metrics.RPE(metrics.PoseRelation.translation_part, delta=100, delta_unit=metrics.Unit.frames, all_pairs=False)
    rpe.process_data((as_evo(truth_path(), STAMPS), as_evo(estimate_path(1), STAMPS)))
    found = path_errors(trajectory(estimate_path(1)), trajectory(truth_path())).metrics()
    assert found["error_10s_m"] == pytest.approx(rpe.get_statistic(metrics.StatisticsType.rmse), rel=1e-6)


def test_the_truth_is_interpolated_where_stamps_differ():
    late = STAMPS[:-1] + 50_000_000
    truth = trajectory(truth_path())
    between = truth.at((late - STAMPS[0]) * 1e-9, int(STAMPS[0]))
    assert path_errors(trajectory(between, late), truth, align="none").metrics()["ate_m"] < 1e-9


@pytest.mark.parametrize("turned", [0.0, 2.0])
def test_nees_of_the_right_covariance_is_one_however_the_map_is_turned(turned):
    rng = np.random.default_rng(3)
    root = np.array([[0.05, 0.0, 0.0], [0.03, 0.02, 0.0], [0.0, 0.01, 0.02]])
    own = truth_path() + rng.standard_normal((N, 3)) @ root.T
    covariance = np.broadcast_to(root @ root.T, (N, 3, 3))
    frame = np.array([5.0, 1.0, turned])
    turn = np.eye(3)
    turn[:2, :2] = [[np.cos(turned), -np.sin(turned)], [np.sin(turned), np.cos(turned)]]
    found = path_errors(
        trajectory(compose(frame, own)), trajectory(truth_path()), covariance=turn @ covariance @ turn.T
    ).metrics()
    assert found["nees"] == pytest.approx(1.0, abs=0.1)
    assert found["inside_95"] == pytest.approx(0.95, abs=0.02)


def with_jump(size_m, from_s, to_s):
    own = truth_path()
    t_s = np.arange(N) * 0.1
    own[(t_s >= from_s) & (t_s < to_s), 0] += size_m
    return path_errors(trajectory(own), trajectory(truth_path()), align="none")


def test_a_loss_is_reported_when_it_begins_and_only_where_it_lasts():
    limits = Limits(lost_m=1.0, lost_s=10.0)
    assert with_jump(1.5, 30.0, 38.0).failure(limits) is None
    lost = with_jump(1.5, 30.0, 45.0).failure(limits)
    assert (lost.kind, lost.t_s) == ("lost", pytest.approx(30.0))
    assert lost.distance_m == pytest.approx(0.04 * 300, rel=1e-3)
    assert with_jump(1.5, 118.0, 1e9).failure(limits).kind == "lost"
    assert with_jump(15.0, 30.0, 1e9).failure(limits).kind == "diverged"


def test_jumps_are_counted_both_ways():
    assert len(with_jump(0.6, 30.0, 31.0).jumps(Limits(jump_m=0.5))) == 2
    assert len(with_jump(0.4, 30.0, 31.0).jumps(Limits(jump_m=0.5))) == 0


def test_coverage_is_of_the_path_and_not_of_the_time():
    half = path_errors(trajectory(truth_path()[: N // 2], STAMPS[: N // 2]), trajectory(truth_path()))
    assert half.coverage == pytest.approx(0.5, abs=0.01)
    parked = np.concatenate((truth_path(), np.repeat(truth_path()[-1:], N, axis=0)))
    stamps = 10**18 + np.arange(2 * N) * 100_000_000
    assert path_errors(trajectory(truth_path()), Trajectory(stamps, parked)).coverage == pytest.approx(1.0)


def test_positions_alone_have_an_ate_and_no_rpe():
    own = truth_path()
    own[:, 2] = np.nan
    found = path_errors(trajectory(own), trajectory(truth_path())).metrics()
    assert found["ate_m"] < 1e-9
    assert np.isnan(found["rpe_m"])


def test_another_clock_is_said_with_both_spans():
    with pytest.raises(ScoreError, match=r"no time in common.*0\.000 to.*use_sim_time"):
        path_errors(trajectory(truth_path(), STAMPS - 10**18), trajectory(truth_path()))


def pair(rng, rise, scatter=0.2, n=40):
    level = 0.5 * rng.standard_normal(n)
    old, new = np.exp(level + scatter / np.sqrt(2.0) * rng.standard_normal((2, n)))
    return old, new * (1.0 + rise)


@pytest.mark.parametrize("statistic", ["median", "p90"])
def test_20_percent_is_found_in_95_of_100_trials_and_1_of_100_is_falsely_red(statistic):
    """benchmarks/gate.py counts a thousand trials and other scatters."""
    rng = np.random.default_rng(1)
    found = sum(compare_paired(*pair(rng, 0.2), statistic=statistic).rise for _ in range(100))
    false = sum(compare_paired(*pair(rng, 0.0), statistic=statistic).rise for _ in range(100))
    assert found >= 93
    assert false <= 3


def test_a_thousand_runs_do_not_turn_a_rise_of_5_percent_red():
    found = compare_paired(*pair(np.random.default_rng(9), 0.05, n=1000), rise=0.2)
    assert not found.rise
    assert found.p < 1e-3
    assert found.low < 1.05 < found.high


def test_a_rise_of_the_worst_runs_alone_is_found_by_their_quantile():
    old, new = pair(np.random.default_rng(3), 0.0, 0.05, 100)
    new = np.where(old >= np.quantile(old, 0.8), 2.0 * new, new)
    assert compare_paired(old, new, statistic="p90").rise
    assert not compare_paired(old, new, statistic="median").rise


def test_one_pair_of_results_has_one_verdict_and_equal_results_are_no_rise():
    old, new = pair(np.random.default_rng(4), 0.1)
    assert compare_paired(old, new, statistic="p90") == compare_paired(old, new, statistic="p90")
    found = compare_paired(old, old)
    assert (found.rise, found.ratio, found.p) == (False, 1.0, 1.0)


@pytest.mark.parametrize("n", [12, 60, 300])
def test_the_signed_rank_test_is_scipys(n):
    stats = pytest.importorskip("scipy.stats")
    d = np.random.default_rng(n).normal(0.15, 1.0, n)
    method = "exact" if n < 200 else "approx"
    expected = stats.wilcoxon(d, alternative="greater", method=method, correction=n >= 200).pvalue
    assert _signed_rank(d) == pytest.approx(expected, rel=2e-3)


def result(values, failed=(), seed=7, missing=()):
    return {
        "runs": [
            {"name": f"run_{i:06d}", "seed": seed, "metrics": {"ate_m": None if i in missing else float(v)},
             "scored": i not in missing, "failed": i in failed or i in missing, "source": f"run_{i:06d}.tum"}
            for i, v in enumerate(values)
        ]
    }  # fmt: skip


def test_a_failed_rule_names_statistic_unit_and_the_worst_runs():
    old, new = pair(np.random.default_rng(6), 0.5)
    (verdict,) = check(result(new), ["ate_p90 +20%"], result(old))
    worst = int(np.argmax(new / old))
    assert verdict.failed
    assert verdict.sentence.startswith("ate_p90 +20%: FAILED. p90 of ate: ")
    assert f"{np.quantile(old, 0.9):.3g} m -> {np.quantile(new, 0.9):.3g} m (" in verdict.sentence
    assert ", limit +20 %); a typical run" in verdict.sentence
    assert "40 pairs" in verdict.sentence
    assert verdict.runs[0] == f"run_{worst:06d}, seed 7, run_{worst:06d}.tum: {old[worst]:.3g} m -> {new[worst]:.3g} m"


@pytest.mark.parametrize(
    ("rules", "crashes", "failing"),
    [(["ate_median +20%"], 1, ["crashes"]), (["ate_median +20%", "lost +1"], 1, []),
    (["ate_median +20%", "lost +1"], 2, ["lost +1"]), (["ate_p90 +20%", "lost +5%"], 1, []),
    (["ate_p90 +20%", "lost +10%"], 2, ["ate_p90 +20%"]), (["ate_p90 +20%", "lost +50%"], 4, ["ate_p90 +20%"]),
    (["ate_p90 +20%", "lost +0"], 1, ["lost +0"]), (["ate_p90 +20%", "lost +5%"], 5, ["ate_p90 +20%", "lost +5%"])],
)  # fmt: skip
def test_a_crash_fails_unless_a_rule_allows_it_and_counts_as_an_infinite_error(rules, crashes, failing):
    old, _ = pair(np.random.default_rng(2), 0.0, n=20)
    verdicts = check(result(old, missing=range(crashes)), rules, result(old))
    assert [one.rule for one in verdicts if one.failed] == failing
    for one in verdicts:
        if one.failed and "lost" in one.rule:
            assert one.runs == tuple(f"run_{i:06d}, seed 7, run_{i:06d}.tum: ok -> failed" for i in range(crashes))
    # crashes that the baseline had, too, are none of this version
    again = check(result(old, missing=range(crashes)), rules, result(old, missing=range(crashes)))
    assert not any(one.failed for one in again)


def test_a_verdict_that_the_limit_alone_does_not_explain_says_why_and_few_pairs_what_they_find():
    below, above = "below the limit, but one of these rises is", "above the limit, but not significant (level 1 %)"
    for seed, rise, why in ((3, 0.0, above), (1, 0.25, below)):
        old, new = pair(np.random.default_rng(seed), rise, n=20)
        (verdict,) = check(result(new), ["ate_p90 +20%"], result(old))
        assert (verdict.failed, why in verdict.sentence) == (rise > 0.0, True)
    old, new = pair(np.random.default_rng(8), 0.0, scatter=0.8, n=12)
    (verdict,) = check(result(new), ["ate_median +20%"], result(old))
    assert "; with this scatter 12 pairs reliably show +" in verdict.sentence


def test_losses_are_counted_not_tested():
    for n, rises in ((5, True), (4, False)):
        assert check(result(np.ones(40), failed=range(n)), ["lost +10%"], result(np.ones(40)))[0].failed is rises


def test_an_absolute_rule_needs_no_baseline():
    rules = ["ate_max > 0.5", "lost > 10%", "lost > 1"]
    low, part, count = check(result([0.1, 0.2, 0.3], failed={1}), rules)
    assert low.sentence == "ate_max > 0.5: passed. max of ate: 0.3 m (limit 0.5 m), 3 runs"
    assert (low.failed, part.failed, count.failed) == (False, True, False)
    assert check(result([0.1, 0.2, 0.3], missing={1}), ["ate_max > 0.5"])[0].failed


def test_identical_estimates_fail_every_gate():
    values = np.ones(10)
    verdicts = check(result(values) | {"identical": True}, ["ate_median > 3"])
    assert [one.rule for one in verdicts if one.failed] == ["identical"]
    assert "not run again" in verdicts[-1].sentence
    assert check(result(values) | {"identical": True}, []) == []


def test_a_baseline_of_other_bags_or_options_is_refused():
    values, batch = np.ones(10), {"inputs": [{"batch": "", "input": "a", "model": "b"}], "estimate": "/amcl_pose"}
    check(result(values) | batch, ["ate_p90 +20%"], result(values) | batch)
    for other in ({"inputs": [{"batch": "", "input": "a", "model": "c"}]}, {"estimate": "/pose"}):
        with pytest.raises(ScoreError, match="in the baseline; "):
            check(result(values) | batch, ["ate_p90 +20%"], result(values) | batch | other)


def test_repeated_baselines_are_the_median_of_each_run_and_their_scatter_is_said():
    old, new = pair(np.random.default_rng(3), 0.0, n=20)
    lost = [result(old * 1.1), result(old), result(old * 0.8, missing={0})]
    typical = typical_of(lost)["runs"]
    assert [run["metrics"]["ate_m"] for run in typical[1:]] == pytest.approx(old[1:])
    assert (typical[0]["scored"], typical[0]["metrics"]["ate_m"]) == (True, pytest.approx(1.1 * old[0]))
    assert [run["mad"]["ate_m"] for run in typical[1:]] == pytest.approx(0.1 * old[1:])
    (verdict,) = check(result(new), ["ate_median +20%"], lost)
    assert "; repeats of the baseline differ by 0." in verdict.sentence
    assert check(result(1.6 * old), ["ate_median +20%"], lost)[0].failed


@pytest.mark.parametrize(
    ("rule", "said"),
    [("ate_p90 20%", "not understood"), ("speed_p90 +20%", "no metric speed_p90"),
    ("ate_p90 +0%", "more than 0"), ("ate_p90 +0.2", "percentage")],
)  # fmt: skip
def test_a_rule_that_is_none_is_refused_with_an_example(rule, said):
    with pytest.raises(ScoreError, match=said):
        parse_rule(rule)


def test_what_cannot_be_compared_is_said():
    values = np.ones(40)
    with pytest.raises(ScoreError, match="name it with baseline"):
        check(result(values), ["ate_p90 +20%"])
    with pytest.raises(ScoreError, match="no run in common"):
        check(result(values), ["ate_p90 +20%"], result(values, seed=8))
    (verdict,) = check(result(values[:5]), ["ate_p90 +20%"], result(values))
    assert (verdict.failed, verdict.comparison, "takes 8 or more" in verdict.sentence) == (True, None, True)
    with pytest.raises(ScoreError, match="not a result of score"):
        check(result(values), ["ate_p90 +20%"], {"runs": 3})


D5, SLOPE = 0.05, 3.0


def runs_of(rng, n):
    """Return drifts (n,) and losses (n,) of a localiser that breaks down at `D5`."""
    drift = np.exp(rng.uniform(np.log(0.01), np.log(0.5), n))
    p = 1.0 / (1.0 + np.exp(-(np.log(0.05 / 0.95) + SLOPE * np.log(drift / D5))))
    return drift, rng.random(n) < p


@pytest.mark.parametrize("q", ["median", "p90"])
def test_intervals_of_quantiles_cover_with_95_percent(q):
    rng = np.random.default_rng(1)
    true = {"median": 0.0, "p90": 1.2816}[q]
    found = [getattr(summarise(rng.standard_normal(60)), q) for _ in range(400)]
    assert np.mean([f.low <= true <= f.high for f in found]) > 0.93


def test_runs_without_the_number_do_not_count():
    found = summarise(np.array([1.0, np.nan, 3.0]))
    assert (found.n, found.mean, found.max) == (2, 2.0, 3.0)
    assert summarise(np.array([np.nan])).n == 0


@pytest.mark.slow
def test_the_breakdown_point_is_found_and_its_interval_covers():
    rng = np.random.default_rng(2)
    found = [breakdown(*runs_of(rng, 100)) for _ in range(40)]
    assert np.median([f.drift for f in found]) == pytest.approx(D5, rel=0.15)
    assert np.mean([f.low <= D5 <= f.high for f in found]) >= 0.88


def test_runs_that_part_cleanly_have_the_point_between_them():
    drift = np.geomspace(0.01, 0.5, 40)
    found = breakdown(drift, drift > 0.1)
    assert 0.06 < found.drift < 0.12
    assert found.low < found.drift < found.high


def test_the_breakdown_point_is_not_extrapolated_beyond_the_drifts_of_the_runs():
    drift = np.geomspace(0.01, 0.1, 60)
    none, every = breakdown(drift, np.zeros(60, bool)), breakdown(drift, np.ones(60, bool))
    assert (none.drift, none.high) == (np.inf, np.inf)
    assert 0.0 < none.low <= drift[-1]
    assert (every.drift, every.low, every.width) == (0.0, 0.0, None)
    assert drift[0] <= every.high < 0.05
    # fewer than 5 % fail at every drift, or more
    few, many = breakdown(drift, np.arange(60) == 30), breakdown(drift, np.arange(60) % 10 == 0)
    assert (few.drift, few.high, few.width) == (np.inf, np.inf, None)
    assert (many.drift, many.low, many.width) == (0.0, 0.0, None)
    assert breakdown(drift[:4], drift[:4] > 0.0).drift is None


def test_growth_has_the_power_it_was_made_with():
    rng = np.random.default_rng(4)
    drift = rng.uniform(0.01, 0.3, 100)
    found = growth(drift, 2.0 * drift**1.5 * np.exp(0.1 * rng.standard_normal(100)))
    assert found.low < 1.5 < found.high
    assert found.high - found.low < 0.2
    assert growth(drift[:5], drift[:5]) is None


def test_sections_tell_where_errors_and_losses_are():
    clean = np.linspace(0.0, 20.0, 201)
    error = np.where((clean > 10.0) & (clean < 12.0), 1.0, 0.1)
    found = sections([(clean, error)] * 4, clean, np.column_stack((clean, clean)), [10.5, 11.5, 20.0])
    worst = max(found, key=lambda s: s.median_m)
    assert 10.0 <= worst.from_m < 12.0
    assert worst.xy_m[0] == pytest.approx((worst.from_m + worst.to_m) / 2.0, abs=0.1)
    assert sum(s.failures for s in found) == 3

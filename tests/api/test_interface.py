"""The Python interface: its names, its results, and that it agrees with the command line."""

import doctest
import importlib
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import odomcorrupt as oc
from odomcorrupt.cli import run
from odomcorrupt.errors import ModelError, OdomCorruptError
from odomcorrupt.extras import part_of_study
from odomcorrupt.study.select.decisions import DECISIONS
from odomcorrupt.trajectories import read_drive
from recordings import OFFICE, ROOT
from test_refusals import ROBOT

NOISE = oc.Noise(alpha=(0.05, 0.02, 0.05, 0.01))
ALPHA = ["--alpha", "0.05", "0.02", "0.05", "0.01"]


def test_the_import_brings_nothing_heavy():
    code = "import sys, odomcorrupt; print({'numpy', 'scipy', 'click', 'pandas', 'matplotlib'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_every_public_name_can_be_had_and_no_other():
    assert set(oc.__all__) <= set(dir(oc))
    for name in oc.__all__:
        assert getattr(oc, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'corupt'"):
        oc.corupt  # noqa: B018 - the access is the test


def test_functions_stay_functions_when_rooms_are_imported():
    modules = ("corruption.run", "correction.run", "batching.dispersion", "simulation.run", "forecasting")
    for module in (*modules, "inspection"):
        importlib.import_module(f"odomcorrupt.{module}")
    names = ("corrupt", "correct", "batch", "spread", "simulate", "preview", "info")
    assert all(callable(getattr(oc, name)) for name in names)
    rooms = {path.parent.name for path in ROOT.glob("odomcorrupt/*/__init__.py")}
    assert not (rooms | {path.stem for path in ROOT.glob("odomcorrupt/*.py")}) & set(oc.__all__)


def test_the_bytes_are_those_of_the_command_line(tmp_path):
    ours, theirs = tmp_path / "a.mcap", tmp_path / "b.mcap"
    done = oc.corrupt(str(OFFICE), ours, model=NOISE, seed=7, run=2)
    assert run([str(OFFICE), str(theirs), "-q", *ALPHA, "--seed", "7", "--run", "2"]) == 0
    assert ours.read_bytes() == theirs.read_bytes()
    assert (done.seed, done.run, done.moved["/odom"]) == (7, 2, 3000)


def test_a_path_of_numbers_is_corrupted_as_the_bag_is(tmp_path):
    target = tmp_path / "noisy.mcap"
    model = oc.Model(NOISE, effects=["unequal_wheels:curvature=0.005"])
    oc.corrupt(OFFICE, target, model=model, seed=3)
    clean, noisy = read_drive(OFFICE, None), read_drive(target, None)
    ours = model.corrupt_path(clean.stamps_ns * 1e-9 - clean.stamps_ns[0] // 10**9, clean.xyt, seed=3, runs=2)
    assert ours.shape == (2, len(clean), 3)
    np.testing.assert_allclose(ours[0], noisy.xyt, atol=2e-6)
    assert np.abs(ours[1] - ours[0]).max() > 0.01


@pytest.mark.parametrize(
    ("options", "arguments"),
    [
        ("", {}),
        (
            "--integrate euler --hold previous --twist-noise 0.2 0.04 --runs 3 --seed 5",
            {"rule": "euler", "hold": "previous", "twist_noise": (0.2, 0.04), "runs": 3, "seed": 5},
        ),
        ("--odom-topic /odom --truth /odom", {"odom_topic": "/odom", "truth": "/odom"}),
    ],
    ids=["plain", "noise", "topics"],
)
def test_integrated_odometry_is_that_of_the_command_line(options, arguments, tmp_path, invoke):
    words = ["integrate", OFFICE, tmp_path / "b.mcap", *options.split(), "--plot", tmp_path / "b.png"]
    values = json.loads(invoke([*words, "--json"]).out)
    done = oc.integrate(OFFICE, **arguments)
    assert done.to_dict() == values
    assert done.save(tmp_path / "a.mcap").messages == len(done.rows()) == 3000
    done.plot(tmp_path / "a.png")
    for end in (".mcap", ".png"):
        assert (tmp_path / f"a{end}").read_bytes() == (tmp_path / f"b{end}").read_bytes()
    np.testing.assert_allclose(read_drive(tmp_path / "a.mcap", None).xyt[:, :2], done.runs_xyt[0][:, :2], atol=1e-9)
    with pytest.raises(OdomCorruptError, match="exists"):
        done.save(tmp_path / "a.mcap")


def test_integrated_odometry_has_its_runs_and_its_errors():
    alone, noisy = oc.integrate(OFFICE), oc.integrate(OFFICE, twist_noise=(0.2, 0.04), runs=4, seed=5)
    assert (alone.runs_xyt.shape, noisy.runs_xyt.shape) == ((1, 3000, 3), (4, 3000, 3))
    np.testing.assert_array_equal(alone.runs_xyt[0], noisy.xyt)
    assert alone.own_error.position_m.max() < 0.01
    assert (alone.truth_topic, alone.truth_error, alone.seed) == (None, None, None)
    assert oc.integrate(OFFICE, truth="/odom").truth_error.position_m.max() == alone.own_error.position_m.max()
    drawn = oc.integrate(OFFICE, twist_noise=(0.2, 0.04)).seed
    assert oc.integrate(OFFICE, twist_noise=(0.2, 0.04), seed=drawn).seed == drawn


@pytest.mark.slow
def test_maps_by_odometry_are_those_of_the_command_line(tmp_path, invoke):
    options = [*ALPHA, "--seed", "7", "--run", "2", "--resolution", "0.2"]
    more = ["--max-yaw-rate", "0.5", "--truth", "/odom", "--laser-pose", "0.1,0,0.1"]
    values = json.loads(invoke(["map", OFFICE, "-o", tmp_path / "b.png", *options, *more, "--json"]).out)
    stages = []
    done = oc.draw_maps(
        OFFICE, NOISE, seed=7, run=2, resolution=0.2, max_yaw_rate=0.5, truth="/odom", laser_pose=(0.1, 0.0, 0.1),
        watch=lambda stage, _: stages.append(stage),
    )  # fmt: skip
    assert done.to_dict() == values
    assert [one.name for one in done.maps] == ["clean odometry", "noisy odometry", "truth (/odom)"]
    files = done.save(tmp_path / "a.yaml")
    done.plot(tmp_path / "a.png")
    for file in (*files, tmp_path / "a.png"):
        other = file.with_name(file.name.replace("a", "b", 1)).read_bytes()
        assert file.read_bytes().replace(b"image: a_", b"image: b_") == other
    assert [file.suffix for file in files] == [".pgm", ".yaml"] * 2
    assert (done.method, done.trajectory, stages) == ("odometry", None, ["drawing maps"])
    assert [row["map"] for row in done.rows()] == [one.name for one in done.maps for _ in one.marks_m]
    with pytest.raises(OdomCorruptError, match="exists already"):
        done.save(tmp_path / "a.yaml")
    with pytest.raises(OdomCorruptError, match="ends in nothing"):
        done.save(tmp_path / "map")


@pytest.mark.parametrize(
    ("t", "poses", "said"),
    [
        ([0.0, 1.0], np.zeros((3, 3)), "give shapes"),
        ([0.0, 0.0], np.zeros((2, 3)), "do not increase"),
        ([0.0, 1.0], np.full((2, 3), np.nan), "finite"),
    ],
)
def test_what_is_no_path_is_refused(t, poses, said):
    with pytest.raises(ModelError, match=said):
        oc.Model(NOISE).corrupt_path(t, poses, seed=1)


def test_a_model_comes_back_from_its_file(tmp_path):
    model = oc.Model(NOISE, effects=["wheelbase:e=1%"], track_m=0.3)
    assert oc.Model.load(model.save(tmp_path / "robot.toml")) == model
    assert model.parameters["wheelbase.e"] == 0.01
    with pytest.raises(OdomCorruptError, match="exists already"):
        model.save(tmp_path / "robot.toml")
    with pytest.raises(ModelError, match="no model file and no preset"):
        oc.corrupt(OFFICE, tmp_path / "x.mcap", model="typpical")


def test_an_option_that_is_none_is_named(tmp_path):
    with pytest.raises(TypeError, match="keep_thruth: no such option"):
        oc.corrupt(OFFICE, tmp_path / "x.mcap", keep_thruth="/t")


def test_a_result_is_small_to_print_and_whole_as_values(tmp_path):
    done = oc.corrupt(OFFICE, tmp_path / "a.mcap", model=NOISE, seed=7)
    lines = str(done).splitlines()
    assert len(lines) <= 8
    assert max(map(len, lines[:-2])) <= 80
    assert len(repr(done)) < 120
    assert "<table>" in done._repr_html_()
    assert json.loads(json.dumps(done.to_dict()))["seed"] == 7
    assert done.rows()[0]["drawn_m"] == pytest.approx(done.drift.end_drawn_m)
    pandas = pytest.importorskip("pandas")
    assert isinstance(done.to_pandas(), pandas.DataFrame)
    for one in (done, oc.correct(OFFICE, tmp_path / "b.mcap")):
        with pytest.raises(OdomCorruptError, match="impossible on a pipe"):
            replace(one, target="-").plot(tmp_path / "a.png")


def test_corrupting_again_is_said(tmp_path, invoke):
    oc.corrupt(OFFICE, tmp_path / "a.mcap", model=NOISE, seed=7)
    again = oc.corrupt(tmp_path / "a.mcap", tmp_path / "b.mcap", model=NOISE, seed=8)
    assert again.earlier[0]["seed"] == "7"
    assert "was corrupted before (seed 7" in str(again)
    stored = json.loads(invoke(["info", tmp_path / "b.mcap", "--json"]).out)["provenance"]
    assert [(one["seed"], one["run"]) for one in stored] == [("7", "0"), ("8", "0")]
    assert all("rot_trans = 0.02" in one["model"] for one in stored)


def free_box(folder, low_xy, high_xy):
    """Write a map that is free within a box, and return its path."""
    across, along = (round((high - low) / 0.05) for low, high in zip(low_xy, high_xy, strict=True))
    (folder / "map.pgm").write_bytes(b"P5\n%d %d\n255\n" % (across, along) + b"\xfe" * across * along)
    origin = [*map(float, low_xy), 0.0]
    text = f"image: map.pgm\nresolution: 0.05\norigin: {origin}\noccupied_thresh: 0.65\nfree_thresh: 0.196\nnegate: 0\n"
    (folder / "map.yaml").write_text(text)
    return folder / "map.yaml"


@pytest.mark.parametrize("walled", [False, True])
def test_a_preview_has_the_runs_that_corruption_makes(walled, tmp_path):
    clean = read_drive(OFFICE, None).xyt[:, :2]
    within = free_box(tmp_path, clean.min(axis=0) - 0.3, clean.max(axis=0) + 0.3) if walled else None
    options = {"odom_topic": "/odom", "keep_twist": True, "compression": "zstd"}
    ahead = oc.preview(OFFICE, NOISE, seed=4, run=3, runs=2, within=within, **options)
    made = [
        oc.corrupt(OFFICE, tmp_path / f"{k}.mcap", model=NOISE, seed=4, run=k, within=within, **options) for k in (3, 4)
    ]
    ends = [done.drift.end_drawn_m for done in made]
    assert ahead.rows()[-1]["position_rms_m"] == pytest.approx(np.sqrt(np.mean(np.square(ends))), abs=1e-6)
    free = oc.preview(OFFICE, NOISE, seed=4, run=3, runs=2)
    assert (ahead.to_dict()["rows"] != free.to_dict()["rows"]) == walled


@pytest.mark.parametrize("call", [lambda *bag, **more: oc.preview(*bag, runs=2, **more), oc.info])
def test_damaged_bags_are_read_on_request_and_blocks_can_be_watched(call, tmp_path):
    (tmp_path / "cut.mcap").write_bytes(OFFICE.read_bytes()[:200_000])
    with pytest.raises(OdomCorruptError, match="recover=True"):
        call(tmp_path / "cut.mcap")
    blocks = []
    result = call(tmp_path / "cut.mcap", recover=True, watch=blocks.append)
    assert "truncated" in result.losses[0]
    assert blocks
    assert call(OFFICE).losses == ()


def test_topics_of_a_bag_are_rows_and_say_what_corruption_modifies():
    rows = {row["topic"]: row for row in oc.info(OFFICE).rows()}
    assert {topic for topic, row in rows.items() if row["moved"]} == {"/odom", "/tf"}
    assert rows["/odom"]["messages"] == 3000


def test_parts_of_the_study_run_with_one_thread_of_linear_algebra_and_leave_the_number_of_their_caller():
    def threads():
        return {one["num_threads"] for one in threadpool_info() if one["user_api"] == "blas"}

    with threadpool_limits(2, user_api="blas"):
        assert part_of_study(threads)() == {1}
        assert threads() == {2}
    assert all(hasattr(one, "__wrapped__") for one in (oc.fit, oc.compare, oc.diagnose, oc.learn, oc.read_recordings))


STUDY = {"findings", "recordings"}
"""Modules whose examples are run together, because they take longer."""
MODULES = sorted({home.removeprefix("api.") for home in oc._HOMES if home.startswith("api.")} - STUDY)


@pytest.mark.parametrize("module", MODULES)
def test_the_examples_of_docstrings_run(module, tmp_path, monkeypatch):
    (tmp_path / "fixtures").symlink_to(ROOT / "fixtures")
    monkeypatch.chdir(tmp_path)
    failed, tried = doctest.testmod(importlib.import_module(f"odomcorrupt.api.{module}"), optionflags=doctest.ELLIPSIS)
    assert (failed, tried > 0) == (0, True)


@pytest.mark.slow
def test_the_examples_of_the_study_run(tmp_path, monkeypatch):
    (tmp_path / "fixtures").symlink_to(ROOT / "fixtures")
    monkeypatch.chdir(tmp_path)
    for module in sorted(STUDY):
        assert doctest.testmod(importlib.import_module(f"odomcorrupt.api.{module}")).failed == 0


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda at: oc.corrupt(OFFICE, at / "out.mcap", model=3, seed=1), "model: 3; give a Model"),
        (lambda at: oc.corrupt(OFFICE, at / "out.mcap", model=NOISE, seed=1.5), "seed: 1.5; it must be a whole number"),
        (lambda at: oc.batch(OFFICE, at / "runs", model=NOISE, runs=2, seed=1, output="foo"), "output: foo; give one"),
        (lambda at: oc.batch(OFFICE, at / "runs", model=NOISE, runs=0, seed=1), "runs: 0; make one or more"),
        (lambda _: oc.preview(OFFICE, NOISE, runs=1), "runs: 1; draw two or more"),
        (lambda _: oc.density((0, 0, 0), (1, 0, 0), [[1, 0]], model=NOISE), r"shape \(1, 2\); give x, y and heading"),
        (lambda _: oc.Noise(alpha=(0.1, 0.1, 0.1, 0.1), law="cubic"), "cubic"),
        (lambda _: oc.integrate(OFFICE, twist_noise=(1.0, 1.0), runs=0), "runs 0: draw one or more"),
        (lambda _: oc.integrate(OFFICE, rule="simpson"), "rule simpson: is not one of"),
        (lambda _: oc.integrate(OFFICE, hold="both"), "hold both: is not one of"),
        (lambda at: oc.integrate(OFFICE).save(at / "out.txt"), "is not a bag format"),
        (lambda _: oc.draw_maps(OFFICE, method="scan"), "method scan: is not one of odometry, laser"),
        (lambda _: oc.draw_maps(OFFICE, method="laser", truth="/odom"), "method laser .* takes no truth"),
        (lambda _: oc.draw_maps(OFFICE, laser_pose=(0.1, 0.0)), r"laser_pose \(0.1, 0.0\): give x, y and heading"),
        (lambda _: oc.draw_maps(OFFICE, resolution=0.0), "resolution 0.0: the side of a cell"),
        (lambda _: oc.draw_maps(OFFICE, max_yaw_rate=-1.0), "max_yaw_rate -1.0: it must be zero"),
    ],
    ids=lambda given: given if isinstance(given, str) else "",
)
def test_a_wrong_argument_is_named_with_its_value_and_leaves_nothing_behind(tmp_path, call, words):
    with pytest.raises(OdomCorruptError, match=words):
        call(tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_one_effect_may_be_given_without_a_list():
    alone, listed = (oc.Model(NOISE, effects=given) for given in ("wheelbase:e=1%", ["wheelbase:e=1%"]))
    assert alone == listed
    assert alone.with_effects(alone.effects[0]).effects == (*alone.effects, *alone.effects)
    html = alone._repr_html_()
    assert "wheelbase.e" in html
    assert "0.01" in html


def test_other_thresholds_of_the_selection_give_another_result(tmp_path):
    drive, none = tmp_path / "run.mcap", replace(DECISIONS, term_nats=1e9)
    # with the thresholds of the package both find the wheelbase
    oc.simulate(drive, effects=["wheelbase"], size=3.0, seed=1, duration_s=40.0)
    assert oc.diagnose(drive, decisions=none).missing == ()
    learned = oc.learn(drive, decisions=none)
    assert (learned.missing, learned.result.search.decisions) == ((), none)


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
def test_values_texts_and_pictures_are_those_of_the_command_line(name, tmp_path, monkeypatch, invoke):
    monkeypatch.chdir(tmp_path)
    Path("robot.toml").write_text(MODEL_FILE)
    if name == "spread":
        oc.batch(OFFICE, "runs", model=NOISE, runs=3, seed=1, output="trajectories")
    call, words = (READS | STATED)[name]
    result = call()
    assert json.loads(invoke([*words, "--json"]).out) == json.loads(json.dumps(result.to_dict()))
    assert invoke([*words, "-v"]).out.startswith(result.details() + "\n")
    assert len(result.rows()) > 3 * (name in READS)
    shown, own = (text.partition("\nnext")[0].rstrip().splitlines() for text in (invoke(words).out, str(result)))
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
